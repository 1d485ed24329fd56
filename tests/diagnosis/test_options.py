"""Every threshold of the diagnosis is documented where it is defined."""

import inspect
import re
from dataclasses import fields

from lieid_casadi.diagnosis import DiagnosisOptions

SOURCES = ("Statistics", "Resolution", "Simulations", "Cost", "JSON format states")


def test_every_option_states_its_meaning():
    source = inspect.getsource(DiagnosisOptions)
    for option in fields(DiagnosisOptions):
        match = re.search(rf"((?:    #: .+\n)+)    {option.name}: ", source)
        assert match, option.name
        comment = " ".join(line.strip(" #:") for line in match.group(1).splitlines())
        assert any(name in comment for name in SOURCES), (option.name, comment)
