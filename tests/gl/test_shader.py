"""Shader sources: includes, constants and messages that name file and line."""

import numpy as np
import pytest

from avatarrex.gl import ShaderError, compute_shader, draw_program, gl_context, load_shader


@pytest.fixture
def shaders(tmp_path, monkeypatch):
    """An empty shader folder; write files into it by name."""
    monkeypatch.setattr("avatarrex.gl.shader.files", lambda package: tmp_path)

    def write(name: str, text: str) -> None:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)

    return write


COMPUTE = "layout(local_size_x = 1) in;\n"


def test_includes_are_recursive_and_happen_once(shaders):
    shaders("lib/c.glsl", "float c() { return 3; }\n")
    shaders("lib/b.glsl", '#include "lib/c.glsl"\nfloat b() { return c(); }\n')
    shaders("a.comp", '#include "lib/b.glsl"\n#include "lib/c.glsl"\nvoid main() {}\n')
    source = load_shader("a.comp")
    assert source.files == ("a.comp", "lib/b.glsl", "lib/c.glsl")
    assert source.text.count("float c()") == 1
    assert source.text.index("float c()") < source.text.index("float b()")
    assert source.text.startswith("#version 430\n")


@pytest.mark.parametrize(("name", "line"), [("a.comp", 4), ("lib/b.glsl", 3), ("lib/c.glsl", 2)])
def test_a_compiler_message_names_file_and_line(shaders, name, line):
    texts = {
        "lib/c.glsl": "\n\n",
        "lib/b.glsl": '#include "lib/c.glsl"\n\n\n',
        "a.comp": COMPUTE + '#include "lib/b.glsl"\n\n\nvoid main() {}\n',
    }
    lines = texts[name].split("\n")
    lines[line - 1] = "wrong;"
    texts[name] = "\n".join(lines)
    for path, text in texts.items():
        shaders(path, text)
    with pytest.raises(ShaderError, match=f"shaders/{name}:{line}"):
        compute_shader(gl_context(), "a.comp")


def test_the_failing_stage_of_a_pair_is_named(shaders):
    shaders("a.vert", "void main() { gl_Position = vec4(0); }\n")
    shaders("a.frag", "\nout vec4 colour;\nvoid main() { colour = nothing; }\n")
    with pytest.raises(ShaderError, match=r"shaders/a\.frag:3"):
        draw_program(gl_context(), "a.vert", "a.frag")


def test_a_missing_include_names_who_includes_it(shaders):
    shaders("a.comp", COMPUTE + '#include "lib/none.glsl"\n')
    with pytest.raises(ShaderError, match=r"shaders/lib/none.glsl: no such shader, included by shaders/a.comp:2"):
        load_shader("a.comp")


def test_constants_reach_the_program(shaders):
    shaders(
        "a.comp",
        COMPUTE + "layout(std430, binding = 0) buffer Out { float value[]; };\n"
        "void main() { value[0] = SOME ? COUNT + SCALE : 0; value[1] = SMALL; }\n",
    )
    context = gl_context()
    program = compute_shader(context, "a.comp", {"SOME": True, "COUNT": 2, "SCALE": 0.5, "SMALL": 1e-12})
    buffer = context.buffer(reserve=8)
    buffer.bind_to_storage_buffer(0)
    program.run()
    context.memory_barrier()
    np.testing.assert_allclose(np.frombuffer(buffer.read(), "f4"), [2.5, 1e-12], rtol=1e-6)
