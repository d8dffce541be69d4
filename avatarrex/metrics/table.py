"""Tables of words in the terminal, at once or line by line."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence


def aligned(rows: Sequence[Sequence[str]], right: Container[int] = ()) -> list[str]:
    """Lines in which every column is as wide as its widest word; the columns `right` end at the same place."""
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = ([w.rjust(n) if k in right else w.ljust(n) for k, (w, n) in enumerate(zip(row, widths))] for row in rows)
    return ["  ".join(line).rstrip() for line in lines]


def printed(*heads: str, width: int = 10) -> Callable[..., None]:
    """Print the heads; what is returned prints a row at once. Columns of `width` characters, or as wide as their head."""
    widths = [max(width, len(head)) for head in heads]

    def row(*cells: object) -> None:
        first, *others = map(str, cells)
        print(first.ljust(widths[0]), *(word.rjust(n) for word, n in zip(others, widths[1:])), flush=True)

    row(*heads)
    return row
