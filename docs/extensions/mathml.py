"""Formulas as MathML, which browsers draw themselves: pages load nothing from the network."""

import re
from html import escape

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

ACCENT = re.compile(r"\\(?:dot|ddot|hat|bar|tilde)\{[^{}]*\}")


def mathml(text, **options):
    """Return a formula as MathML; a subscript of q̇ stands beside it and not below."""
    return tex2mathml(ACCENT.sub(r"{\g<0>}", text), **options)


def visit_inline(self, node):
    """Write an inline formula."""
    self.body.append(f'<span class="math">{mathml(node.astext())}</span>')
    raise nodes.SkipNode


def visit_display(self, node):
    """Write a formula on a line of its own, with its number where it has one."""
    self.body.append(self.starttag(node, "div", CLASS="math"))
    if node["number"]:
        self.body.append(f'<span class="eqno">({escape(str(node["number"]))})</span>')
    for part in node.astext().split("\n\n"):
        self.body.append(mathml(part, as_block=True))
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app):
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_display, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
