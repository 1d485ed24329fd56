"""Location of the C code: runtime headers, templates, example controller."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def codegen_folder() -> Path:
    """Folder with the C code that exported models are built with.

    In a wheel it is inside the package; in a checkout (also an editable install) it is at the top
    level, next to the package.
    """
    for folder in (_PACKAGE / "codegen", _PACKAGE.parent / "codegen"):
        if (folder / "README.md").is_file():
            return folder
    raise FileNotFoundError(
        f"the C code of lieid-casadi is missing: no folder 'codegen' in {_PACKAGE} or next to it; "
        "install the package again"
    )
