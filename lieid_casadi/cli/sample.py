"""``lieid sample FIT -n N -o DIR``: physically consistent draws from the posterior of a fit."""

from __future__ import annotations

import lieid_casadi as lieid
from lieid_casadi.cli import inputs, output
from lieid_casadi.cli.options import Args, command
from lieid_casadi.tables import Table, make_table


@command("sample", "physically consistent draws from the posterior of a fit")
def run(args: Args) -> output.Outcome:
    """Draw physically consistent parameters from the posterior of a fit of method feasible.

    Rivals that the recordings do not separate from it can be drawn, too. The samples are for
    ensembles and domain randomisation.

    fit FIT: input  fit to sample
    -n N: count = 100  number of samples
    --rival FIT: input repeated  fit with other effects that the data do not separate
    --weights W …: number  probabilities of the fit and its rivals, in proportion; default:
        by their errors on --test, else equal
    --test REC …: input  recordings that were not used for training: how much of their
        torque the samples cover
    --to {npz,mjcf,urdf} = npz  models of every sample besides samples.npz
    @FOLDER
    --seed N: seed = 0  seed of the draws
    @RECORDING @JSON
    """
    from lieid_casadi.exporters.export import export_samples
    from lieid_casadi.identification.ensemble import ensemble_coverage, model_weights

    fit, *rivals = fits = [lieid.Fit.load(path) for path in (args.fit, *args.rival)]
    test = inputs.recordings_of(args.test, args, fit)
    weights = args.weights or None
    if test and rivals and weights is None:
        weights = model_weights(fits, test, seed=args.seed)
    with output.progress("sample") as report:
        samples = fit.sample(
            args.n, seed=args.seed, rivals=rivals, weights=weights, progress=report
        )
    made = export_samples(samples, args.output, to=args.to, force=args.force)
    shown: list[str | Table] = [
        f"{len(samples)} samples written to {args.output}: {len(made.files)} files"
    ]
    if rivals:
        drawn = [",".join(s.model.effects) for s in samples]
        texts = [",".join(one.model.effects) for one in fits]
        rows = [(text, drawn.count(text)) for text in dict.fromkeys(texts)]
        shown.append(make_table("Models of the samples", ("effects", "samples"), rows))
    coverage = None
    if test:
        coverage = ensemble_coverage(samples, test)
        shown.append(coverage.sentence)
    else:
        shown.append(
            "They state the uncertainty of the parameters, not errors of the model; --test REC "
            "compares them with a recording."
        )
    content = {
        "samples": len(samples),
        "models": [",".join(s.model.effects) for s in fits],
        "weights": None if weights is None else [float(w) for w in weights],
        "coverage": None if coverage is None else coverage.to_dict(),
    }
    return output.Outcome([*shown, *(f"  ! {note}" for note in made.notes)], json=content)
