"""Text that is safe in XML comments and attributes."""

from __future__ import annotations

import re
import unicodedata
from xml.sax.saxutils import quoteattr

# all that XML 1.0 does not allow, not even as a reference
_FORBIDDEN = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def attribute(text: str) -> str:
    """Return a quoted attribute value; characters that XML does not allow become U+FFFD.

    Examples
    --------
    >>> print(attribute("a<b>"))
    "a&lt;b&gt;"
    """
    return quoteattr(allowed(text))


def allowed(text: str) -> str:
    """Return text in which characters that XML does not allow are U+FFFD."""
    return _FORBIDDEN.sub("\ufffd", text)


def comment(text: str) -> str:
    """Return text that is safe in an XML comment, in one line.

    Examples
    --------
    >>> comment("a---><evil/>")
    'a- - -><evil/>'
    """
    shown = "".join(" " if unicodedata.category(c)[0] == "C" else c for c in text)
    return re.sub(r"-(?=-)|-$", "- ", " ".join(shown.split()))
