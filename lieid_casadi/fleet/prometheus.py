"""The state of a fleet in the text format of Prometheus, for node-exporter's textfile collector."""

from __future__ import annotations

from lieid_casadi.fleet.history import History

#: Of each gauge: its help, and a query of its labels and, last, its value.
GAUGES = {
    "alarm": (
        "Open alarm: part of the joint's torque that the fit no longer predicts.",
        "SELECT serial, coalesce(joint::VARCHAR, '') AS joint, quantity, since, severity "
        "FROM alarms WHERE closed IS NULL ORDER BY severity DESC, since, serial, joint",
    ),
    "alarms": (
        "Number of open alarms of the arm.",
        "SELECT serial, count(quantity) FROM latest LEFT JOIN "
        "(SELECT serial, quantity FROM alarms WHERE closed IS NULL) USING (serial) "
        "GROUP BY serial ORDER BY serial",
    ),
    "last_success_timestamp": (
        "Date (UTC) of the newest night that was diagnosed, of every arm of the file; or 0.",
        "SELECT serial, coalesce(epoch(max(date) FILTER (status = 'done')), 0) "
        "FROM nights GROUP BY serial ORDER BY serial",
    ),
    "nights_missing": (
        "Expected nights of the arm without a recording.",
        "SELECT serial, count(*) FILTER (status = 'missing') FROM nights GROUP BY 1 ORDER BY 1",
    ),
    "newest_night_done": (
        "1 if the arm's newest expected night was diagnosed; 0: missing, refused or failed.",
        "SELECT serial, arg_max(status, date) = 'done' FROM nights GROUP BY 1 ORDER BY 1",
    ),
    "error_ratio": (
        "Error in motion of the last night over the error that the fit expects.",
        "SELECT serial, joint, rms_moving / expected AS ratio FROM latest "
        "JOIN errors USING (run_id, serial) WHERE isfinite(ratio) ORDER BY serial, joint",
    ),
    "parameter": (
        "Coefficient of an effect on the last night, SI units.",
        "SELECT serial, joint, name, value FROM latest JOIN parameters USING (run_id, serial) "
        "ORDER BY serial, name, joint",
    ),
    "last_run": (
        "Arm-nights of the last call of lieid fleet by status.",
        "SELECT unnest(json_keys(counts)) AS status, counts->>status FROM "
        "(SELECT arg_max(counts, finished) AS counts FROM calls) ORDER BY status",
    ),
    "last_run_timestamp": (
        "When the last call ended.",
        "SELECT coalesce(epoch(max(finished)), 0) FROM calls",
    ),
    "last_run_seconds": (
        "Duration of the last call.",
        "SELECT coalesce(arg_max(seconds, finished), 0) FROM calls",
    ),
}
ESCAPED = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})  # in values of labels


def prometheus_text(history: History) -> str:
    """Return the state of a fleet in the text exposition format of Prometheus, as gauges."""
    lines = []
    for name, (text, query) in GAUGES.items():
        lines += [f"# HELP lieid_fleet_{name} {text}", f"# TYPE lieid_fleet_{name} gauge"]
        found = history.connection.execute(query)
        labels = [column[0] for column in found.description[:-1]]
        for *values, value in found.fetchall():
            pairs = zip(labels, map(str, values), strict=True)
            shown = ",".join(f'{label}="{own.translate(ESCAPED)}"' for label, own in pairs)
            braces = f"{{{shown}}}" if shown else ""
            lines.append(f"lieid_fleet_{name}{braces} {float(value)!r}")
    return "\n".join(lines) + "\n"
