"""The workbench: a local web page on which a model is compared with recordings and completed."""

from importlib.util import find_spec

from lieid_casadi.errors import MissingDependency

if find_spec("nicegui") is None:
    raise MissingDependency("the page needs NiceGUI: pip install 'lieid-casadi[workbench]'")
