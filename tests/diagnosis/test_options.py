"""Every threshold of the diagnosis is documented where it is defined."""

import inspect
import re
from dataclasses import fields
from pathlib import Path

from lieid_casadi.diagnosis import DiagnosisOptions

SOURCES = ("Statistics", "Resolution", "Simulations", "Cost", "JSON format states")


def test_every_option_states_its_meaning_and_source():
    source = inspect.getsource(DiagnosisOptions)
    for option in fields(DiagnosisOptions):
        match = re.search(rf"((?:    #: .+\n)+)    {option.name}: ", source)
        assert match, option.name
        comment = " ".join(line.strip(" #:") for line in match.group(1).splitlines())
        assert any(name in comment for name in SOURCES), (option.name, comment)


def test_the_benchmark_of_thresholds_halves_and_doubles_options_that_exist():
    source = (Path(__file__).parents[1] / "benchmarks/diagnosis_thresholds.py").read_text("utf-8")
    (names,) = re.findall(r"THRESHOLDS = \((.+?)\)", source, re.S)
    tabulated = re.findall(r'"(\w+)"', names)
    assert len(tabulated) == 10
    assert set(tabulated) <= {option.name for option in fields(DiagnosisOptions)}
