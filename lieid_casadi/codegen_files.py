"""Location of the C code: runtime headers, templates, example controller."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def codegen_folder() -> Path:
    """Return the folder of the C code: inside a wheel's package, beside that of a checkout."""
    for folder in (_PACKAGE / "codegen", _PACKAGE.parent / "codegen"):
        if (folder / "README.md").is_file():
            return folder
    raise FileNotFoundError(
        f"the C code of lieid-casadi is missing: no folder 'codegen' in {_PACKAGE} or next to it; "
        "install the package again"
    )
