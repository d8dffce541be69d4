"""One web page that shows the avatar: orbit, sliders of expressions and joints, clips. It needs no network and no server.

The page is `web/page.html` with `web/viewer.min.js` (three.js, MIT, bundled once by tools/web_bundle.sh) and the GLB inside, base64.
"""

from __future__ import annotations

import base64
import html
import json
import re
from pathlib import Path

from avatarrex.export.label import Label
from avatarrex.files.gate import read_text

WEB = Path(__file__).parent / "web"


def page(glb: bytes, label: Label) -> str:
    """The page with everything in it. No text of the avatar's can end the element that it stands in."""
    parts = {
        "TITLE": html.escape(label.name),
        "LINES": html.escape("\n".join(label.lines())),
        "LABEL": json.dumps(label.json(), ensure_ascii=False).replace("<", "\\u003c"),
        "GLB": base64.b64encode(glb).decode(),
        "VIEWER": read_text(WEB / "viewer.min.js", "the viewer"),
    }
    text = read_text(WEB / "page.html", "the page")
    return re.sub(r"\{\{([A-Z]+)\}\}", lambda place: parts[place[1]], text)
