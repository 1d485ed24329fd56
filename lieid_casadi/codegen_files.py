"""Where the C side (runtime header, template, CMake project) lies on this machine."""

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def codegen_folder() -> Path:
    """Folder with the C side that exported models are built with.

    A wheel carries it inside the package; in a checkout (also an editable install) it lies
    at the top level, beside the package.

    Returns
    -------
    Path
        An existing folder.

    Raises
    ------
    FileNotFoundError
        If the installation is incomplete.

    Examples
    --------
    >>> (codegen_folder() / "README.md").is_file()
    True
    """
    for folder in (_PACKAGE / "codegen", _PACKAGE.parent / "codegen"):
        if (folder / "README.md").is_file():
            return folder
    raise FileNotFoundError(
        f"the C side of lieid-casadi is missing: no folder 'codegen' in {_PACKAGE} or beside it; "
        "install the package again"
    )
