"""A user's script, as ``test_typing.py`` shows it to a type checker; nobody runs it."""

import numpy as np

import dbo_cli as dbo


def drive_for(recording: str, rate: float, seconds: float) -> list[float]:
    model = dbo.identify(dbo.read_log(recording), gears=64)
    wanted = 5.0 + 2.0 * np.sin(2.0 * np.pi * np.arange(int(seconds * rate)) / rate)
    volts = model.compensate(wanted, sample_rate=rate, v_min=0.0, v_max=100.0)
    moved, state = model.simulate(volts, sample_rate=rate, return_state=True)
    after = model.compensate(wanted, sample_rate=rate, state=state, details=True)
    figures = dbo.report(wanted, moved, sample_rate=rate).to_frame()
    print(model.output.unit, after.clipped, figures, model.warnings)
    live = model.controller(rate, v_max=100.0)
    planned = [float(live.plan(one)) for one in wanted]
    live.commit()
    try:
        dbo.read_model("model.json").inverse().save("inverse.json")
    except dbo.ModelError as problem:
        print(problem.exit_code)
    return [*planned, *volts.tolist()]
