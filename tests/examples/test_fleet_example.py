"""The example fleet is diagnosed as its docstring says; rules and dashboard name real metrics."""

import json
import re
import runpy
import shlex
from pathlib import Path

import pytest
import yaml

from lieid_casadi.cli.main import build_parser, main
from lieid_casadi.fleet.history import History

EXAMPLES = Path(__file__).parents[2] / "examples" / "fleet"


@pytest.mark.slow
def test_the_example_fleet(tmp_path, capsys):
    runpy.run_path(str(EXAMPLES / "make_fleet.py"))["make_fleet"](tmp_path)
    history = str(tmp_path / "history.duckdb")
    words = ["fleet", str(tmp_path / "fleet.yaml"), "-o", history, "--workers", "1"]
    assert main([*words, "--night", "2026-01-12", "--exit-code"]) == 7
    shown = capsys.readouterr().out
    assert shown.count("New alarm: ") == 2  # also A2, whose alarm gains quantities on later nights
    assert "Worse alarm" not in shown
    with History(history, read_only=True) as opened:
        alarms = opened.rows("SELECT serial, quantity, joint FROM alarms ORDER BY serial")
        missing = opened.rows(
            "SELECT serial, count(*) FROM nights WHERE status = 'missing' GROUP BY 1"
        )
    assert alarms == [("A2", "coulomb", 2), ("A3", "payload", None)]
    assert missing == [("A4", 2)]


def test_rules_and_dashboard_name_metrics_of_the_export(tmp_path):
    rules = yaml.safe_load((EXAMPLES / "alerts.yml").read_text("utf-8"))
    board = json.loads((EXAMPLES / "dashboard.json").read_text("utf-8"))
    texts = [rule["expr"] for group in rules["groups"] for rule in group["rules"]]
    texts += [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    used = {name for text in texts for name in re.findall(r"lieid_fleet_\w+", text)}
    with History(tmp_path / "h.duckdb"):
        pass
    out = tmp_path / "f.prom"
    assert main(["fleet", "export", str(tmp_path / "h.duckdb"), "--prometheus", str(out)]) == 0
    exported = set(re.findall(r"# TYPE (\w+) gauge", out.read_text("utf-8")))
    assert len(used) >= 6
    assert used <= exported


def test_the_nightly_jobs_call_commands_that_exist():
    """Compose file and manifest: valid YAML whose `lieid` command lines the parser accepts."""
    compose = yaml.safe_load((EXAMPLES / "compose.yaml").read_text("utf-8"))
    manifests = list(yaml.safe_load_all((EXAMPLES / "kubernetes.yaml").read_text("utf-8")))
    assert set(compose["services"]) == {"scheduler", "worker", "nightly"}
    assert [m["kind"] for m in manifests] == ["DaskCluster", "PersistentVolumeClaim", "CronJob"]
    script = compose["services"]["nightly"]["command"][2]
    lines = [shlex.split(x) for x in script.splitlines() if x.strip().startswith("lieid ")]
    job = manifests[2]["spec"]["jobTemplate"]["spec"]["template"]["spec"]["containers"][0]
    for line in (*lines, job["command"]):
        words = line[1:3] if line[2] in ("check", "report", "export") else line[1:2]
        args = build_parser().parse_args([" ".join(words), *line[1 + len(words) :]])
        assert args.command == " ".join(words)
    assert len(lines) == 4
