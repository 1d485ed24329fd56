"""Documentation site: python -m sphinx -W docs OUT, offline once the packages are installed."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

from sphinx.util import logging  # noqa: E402

import lieid_casadi  # noqa: E402

logger = logging.getLogger(__name__)

project = "lieid-casadi"
author = copyright = "The lieid-casadi developers"
version = release = lieid_casadi.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinxcontrib.programoutput",
    "mathml",
    "api_pages",
    "cli_reference",
    "thresholds",
    "effect_atlas",
]
exclude_patterns = ["_build", "_work", "method/_constants.md", "extensions", "scripts"]

html_theme = "pydata_sphinx_theme"
html_title = f"lieid-casadi {version}"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
html_static_path = ["static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_math_renderer = "mathml"
html_js_files = []

myst_enable_extensions = ["dollarmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_ipywidgets_js = {}  # no page uses widgets, whose scripts come from a network

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike", "NDArray": "NDArray"}
autodoc_mock_imports = ["rosbags", "pyarrow", "pandas"]
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_param = False  # shapes such as (n,) stand where types do, and are no names to link
napoleon_use_rtype = False
suppress_warnings = ["ref.python"]  # the same, for attributes

programoutput_prompt_template = "$ {command}\n{output}"

# Commands of the guides run in a folder that holds what `lieid demo` writes, with the scripts of
# this interpreter first on the path: pages show what the commands printed in this build.
WORK = HERE / "_work"
NOTEBOOK = "find_the_missing_effect"
PROGRAMS = {
    "demo": "lieid demo",
    "uncertainty": f"{sys.executable} examples/uncertainty.py 10",
    "optimal_control": f"{sys.executable} examples/optimal_control.py",
    "experiment": (
        "lieid experiment two_link --yes -o experiment --record "
        "'python examples/experiment_mujoco.py {trajectory} {recording}'"
    ),
    "downstream_controller": (
        f"{sys.executable} examples/downstream_controller.py --robot two_link --seconds 5"
    ),
}
os.environ["PATH"] = f"{sysconfig.get_path('scripts')}{os.pathsep}{os.environ['PATH']}"
os.environ["COLUMNS"] = "96"
os.environ["MPLBACKEND"] = "Agg"
os.environ.pop("FORCE_COLOR", None)


def start_programs(app):
    """Start the demo, which makes recordings, and the examples, while the atlas is drawn."""
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir()
    shutil.copytree(HERE.parent / "examples", WORK / "examples")
    shutil.copytree(HERE / "scripts", WORK / "scripts")
    shutil.copy(HERE.parent / "examples" / f"{NOTEBOOK}.ipynb", HERE / "examples")
    pool = ThreadPoolExecutor(1)
    results = pool.map(run, PROGRAMS)
    app.connect("env-before-read-docs", lambda *_: list(results))


def run(name):
    """Run a program in the work folder and keep what it prints in NAME.txt."""
    output = WORK / f"{name}.txt"
    if name == "downstream_controller" and shutil.which("cmake") is None:
        output.write_text("not run: CMake was not installed where this page was built\n", "utf-8")
        return
    with open(output, "w", encoding="utf-8") as file:
        subprocess.run(shlex.split(PROGRAMS[name]), cwd=WORK, stdout=file, check=True)


def check_offline(app, error):
    """Warn of every script, style sheet or picture that a page would load from a network."""
    if error is not None or app.builder.name != "html":
        return
    outside = re.compile(r"<(?:script|link|img|iframe)[^>]+(?:src|href)=\"(?:https?:)?//[^\"]+\"")
    for page in sorted(Path(app.outdir).rglob("*.html")):
        for tag in outside.findall(page.read_text("utf-8")):
            logger.warning("%s loads from a network: %s", page.relative_to(app.outdir), tag)


def setup(app):
    app.connect("build-finished", check_offline)
    app.connect("builder-inited", start_programs, priority=100)  # before the atlas
