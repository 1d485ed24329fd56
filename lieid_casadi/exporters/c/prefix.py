"""Prefixes of exported C names that would clash with other names or files."""

from __future__ import annotations

import re

from lieid_casadi.errors import ExportError

C_KEYWORDS = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while alignas alignof bool constexpr false nullptr static_assert "
    "thread_local true typeof typeof_unqual asm fortran"
)
CPP_KEYWORDS = (
    "and and_eq bitand bitor catch char8_t char16_t char32_t class compl concept consteval "
    "constinit const_cast co_await co_return co_yield decltype delete dynamic_cast explicit export "
    "friend import module mutable namespace new noexcept not not_eq operator or or_eq private "
    "protected public reinterpret_cast requires static_cast template this throw try typeid "
    "typename using virtual wchar_t xor xor_eq final override"
)
STANDARD_HEADERS = (  # PREFIX.h would be included in their place
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal "
    "stdalign stdarg stdatomic stdbit stdbool stdckdint stddef stdint stdio stdlib stdnoreturn "
    "string strings tgmath threads time uchar wchar wctype memory malloc alloca unistd fcntl "
    "pthread sched semaphore dirent dlfcn features poll sys"
)
BUILD_TARGETS = (  # of CMake and its generators; c and m are libraries
    "all all_build c clean continuous depend edit_cache experimental help install m nightly "
    "package package_source rebuild_cache run_tests test zero_check"
)
OWN_FILES = "lieid_runtime"
_CLASHES = {
    **dict.fromkeys(C_KEYWORDS.split(), "a keyword of C"),
    **dict.fromkeys(CPP_KEYWORDS.split(), "a keyword of C++"),
    **dict.fromkeys(STANDARD_HEADERS.split(), "the name of a system header"),
    **dict.fromkeys(BUILD_TARGETS.split(), "a name that build tools use"),
    **dict.fromkeys(OWN_FILES.split(), "a file of every export"),
}


def check_prefix(prefix: str) -> None:
    """Refuse a prefix that gives no C names, or names that clash.

    Raises `ExportError`.

    Examples
    --------
    >>> check_prefix("left_arm")
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix, re.ASCII):
        raise ExportError(
            f"prefix {prefix!r}: expected letters, digits and _, beginning with a letter"
        )
    # file names differ by more than case on some systems, and macros are in capitals
    clash = _CLASHES.get(prefix.lower())
    if clash is None and prefix.lower().startswith("lieid_"):
        clash = "a name of the runtime header"
    if clash is not None:
        raise ExportError(f"prefix {prefix!r}: is {clash}; expected another, such as my_{prefix}")
