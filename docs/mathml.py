"""Formulas as MathML, which browsers draw by themselves: the site needs no network."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml


def mathml(tex: str, block: bool) -> str:
    """MathML of a formula; sizes of brackets are the browser's, numbers stand beside."""
    tex = re.sub(r"\\[bB]igg?[lr]?(?![a-zA-Z])", "", tex).replace(r"\dots", r"\ldots")
    # \tfrac12 is a half; docutils reads twelve
    tex = re.sub(r"(\\[dt]?frac)\s*(\d)\s*(\d)", r"\1{\2}{\3}", tex)
    return str(tex2mathml(re.sub(r"\\tag\{(.*?)\}", r"\\qquad \\text{(\1)}", tex), as_block=block))


def inline(writer: Any, node: Any) -> None:
    """A formula in a line."""
    writer.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def displayed(writer: Any, node: Any) -> None:
    """A formula of its own."""
    writer.body.append(f'<div class="math">{mathml(node.astext(), block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, Any]:
    """What Sphinx calls."""
    app.add_html_math_renderer("mathml", (inline, None), (displayed, None))
    return {"parallel_read_safe": True}
