import numpy as np
import pytest

from dbo_cli.drive import Limits
from dbo_cli.drive.drive import PassRecord
from dbo_cli.drive.simulate import Rows
from dbo_cli.errors import InputError, UsageError
from dbo_cli.model import Resonance

from .actuators import actuator, plan

pytestmark = pytest.mark.filterwarnings("ignore::dbo_cli.errors.DboWarning")
RATE = 20000.0
DT = 1.0 / RATE


def move(rows=6000):
    t = np.arange(rows) / rows
    u = np.clip((t - 0.1) / 0.8, 0.0, 1.0)
    return 5.0 + 2.5 * np.sin(2 * np.pi * 19 * u) * np.sin(np.pi * u) ** 2


def played(name, voltage, measured, time=None):
    return name, Rows(time, voltage, measured)


MODEL, PLANT = actuator(growth=1.5), actuator(growth=1.7)
LIMITS = Limits.within(MODEL.input)


def learned(model, plant, passes, noise=0.0):
    """Return the error of each pass in % of the move, the model being wrong about the plant."""
    wanted, limits = move(), Limits.within(model.input)
    rng = np.random.default_rng(1)
    history = []
    tracked = []
    errors = []
    for _ in range(passes):
        passes = {"tracked": tracked, "history": history, "on_limit": "clip"}
        drive = plan(model, wanted, DT, limits, state="empty", **passes)
        history = list(drive.history)
        begun = plant.start(float(drive.voltage[0]), "empty")
        y = plant.run(drive.voltage, begun, DT).y
        error = (y - wanted)[700:-700]
        errors.append(100.0 * float(np.std(error)) / float(np.ptp(wanted)))
        measured = y + noise * rng.standard_normal(y.size)
        tracked = [played("pass.csv", drive.voltage, measured)]
    return errors


@pytest.mark.parametrize(
    ("frequency", "damping"),
    [(760.0, 0.02), (700.0, 0.005), (600.0, 0.01), (900.0, 0.005)],
)
def test_learning_converges_with_a_mistuned_model(frequency, damping):
    creep = {"tau": (0.5, 20.0), "gain": (0.002, 0.002)}
    assumed, truth = Resonance(800.0, 0.02), Resonance(frequency, damping)
    model = actuator(256, growth=1.5, sections=(assumed,), **creep)
    plant = actuator(256, growth=1.7, sections=(truth,), **creep)
    errors = learned(model, plant, 12, noise=0.005)
    assert errors[0] > 0.5
    assert errors[3] < 0.5 * errors[0]
    assert max(errors[6:]) < 0.35 * errors[0]


def test_growth_is_refused():
    model, plant, limits = MODEL, actuator(growth=1.8), LIMITS
    wanted = move()
    first = plan(model, wanted, DT, limits, state="empty")
    y = plant.run(first.voltage, plant.start(0.0, "empty"), DT).y
    tracked = [played("pass.csv", first.voltage, y)]
    small = [PassRecord("earlier", 1e-6)]
    with pytest.raises(InputError, match=r"grew.*`bandwidth` .* \(it was"):
        plan(model, wanted, DT, limits, state="empty", tracked=tracked, history=small)
    scaled = [played("pass.csv", first.voltage, 1.3 * y + 0.4)]
    before = [PassRecord("earlier", float(np.std(y - wanted)))]
    with pytest.raises(InputError, match="the sensor's scale"):
        plan(model, wanted, DT, limits, state="empty", tracked=scaled, history=before)
    lesson = plan(model, wanted, DT, limits, state="empty", tracked=tracked)
    again = [*lesson.history, PassRecord("what came of it", 9.0)]
    learned_again = {"state": "empty", "tracked": tracked, "history": again}
    repeated = plan(model, wanted, DT, limits, **learned_again)
    assert repeated.history == lesson.history


def test_recordings_that_do_not_belong():
    model = actuator(growth=1.5)
    wanted, limits = move(), Limits.within(model.input)
    drive = plan(model, wanted, DT, limits, state="empty")
    y = model.run(drive.voltage, model.start(0.0, "empty"), DT).y
    good = played("pass.csv", drive.voltage, y)
    short = played("pass.csv", drive.voltage[:-1], y[:-1])
    other = played("pass.csv", 100.0 - drive.voltage, y)
    slow = played("pass.csv", drive.voltage, y, 2 * DT * np.arange(y.size))
    for wrong in ([short], [other], [slow], [good, other]):
        with pytest.raises(InputError, match=r"pass\.csv"):
            plan(model, wanted, DT, limits, state="empty", tracked=wrong)
    with pytest.raises(InputError, match="holds still"):
        plan(model, np.full(y.size, 5.0), DT, limits, tracked=[good])
    with pytest.raises(UsageError):
        plan(model, wanted, DT, limits, history=[PassRecord("", 1.0)])


def test_a_cut_off_of_0_is_refused():
    """It was taken for none."""
    drive = plan(MODEL, move(), DT, LIMITS, state="empty")
    y = PLANT.run(drive.voltage, PLANT.start(0.0, "empty"), DT).y
    passes = {"tracked": [played("pass.csv", drive.voltage, y)], "bandwidth": 0.0}
    with pytest.raises(UsageError, match="`bandwidth` 0: must be above"):
        plan(MODEL, move(), DT, LIMITS, state="empty", **passes)


def test_a_recording_is_laid_by_its_drive_wherever_it_begins_and_counts_from():
    """However few rows stand before the move: without a clock, by its stamps, and by those of another day."""
    wanted = move()
    first = plan(MODEL, wanted, DT, LIMITS, state="empty").voltage
    before = np.full(30, first[0])
    led = np.concatenate([before, first])
    learned = []
    for voltage, begin in (
        (first, None),
        (np.concatenate([led, before]), None),
        (led, -30 * DT),
        (led, 1000.0),
    ):
        y = PLANT.run(voltage, PLANT.start(0.0, "empty"), DT).y
        time = None if begin is None else begin + DT * np.arange(voltage.size)
        tracked = [played("pass.csv", voltage, y, time)]
        drive = plan(MODEL, wanted, DT, LIMITS, state="empty", tracked=tracked)
        learned.append(drive.voltage)
    for voltage in learned[1:]:
        np.testing.assert_allclose(voltage, learned[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_sensor_that_stands_still_is_refused(noise):
    """The scale to type was infinite, or blew its noise up."""
    wanted = move()
    drive = plan(MODEL, wanted, DT, LIMITS, state="empty")
    still = 3.0 + noise * np.random.default_rng(2).standard_normal(wanted.size)
    tracked = [played("pass.csv", drive.voltage, still)]
    with pytest.raises(InputError, match="does not follow the drive"):
        plan(MODEL, wanted, DT, LIMITS, state="empty", tracked=tracked)


def test_a_learned_pass_is_laid_by_what_led_to_it():
    """By its own shape, no longer the trajectory's, it was laid some rows off where no stamp helped."""
    model, plant = actuator(growth=1.2), actuator(growth=2.2)
    rows, dt = 1000, 1e-3
    wanted = 4.0 - 2.0 * np.cos(2.0 * np.pi * np.arange(rows) / rows)
    more = {"start": 40.0, "approach": "auto", "bandwidth": 40.0}
    limits, begin = Limits.within(model.input), plant.start(40.0, "settled")
    tracked, held = [], np.full(5, 40.0)
    for _ in range(3):
        given = more if tracked else {**more, "bandwidth": None}
        drive = plan(model, wanted, dt, limits, tracked=tracked, **given)
        voltage = np.append(held, drive.voltage)
        measured = plant.run(voltage, begin, dt).y
        stamps = drive.time[0] + dt * np.arange(-held.size, drive.voltage.size)
        tracked = [played("pass.csv", voltage, measured, stamps)]
        by_stamps = plan(model, wanted, dt, limits, tracked=tracked, **more)
        for other in (stamps + 100.0, stamps - stamps[0]):
            late = [played("pass.csv", voltage, measured, other)]
            by_drive = plan(model, wanted, dt, limits, tracked=late, **more)
            np.testing.assert_array_equal(by_drive.voltage, by_stamps.voltage)


@pytest.mark.parametrize(
    ("begin", "rows"), [(0, 500), (170, 500), (440, 500), (20, 900), (170, 1170)]
)
def test_a_recording_of_a_loop_may_begin_anywhere_and_hold_one_period(begin, rows):
    """A recorder is started while the loop runs: its first row is not the period's."""
    phase = 2 * np.pi * np.arange(500) / 500
    wanted = 5.0 + 2.0 * np.sin(phase) + np.cos(2 * phase)
    loop = plan(MODEL, wanted, 1e-3, LIMITS, periodic=True)
    voltage = np.tile(loop.voltage, 8)
    y = PLANT.run(voltage, PLANT.start(float(voltage[0])), 1e-3).y
    learned = []
    for stretch in (slice(2000, 4000), slice(2000 + begin, 2000 + begin + rows)):
        tracked = [played("pass.csv", voltage[stretch], y[stretch])]
        drive = plan(MODEL, wanted, 1e-3, LIMITS, periodic=True, tracked=tracked)
        learned.append(drive.voltage)
    time = 1e-3 * np.arange(float(rows))
    for begin in (-1000.0, 1000.0):  # as it began to count, which says nothing
        tracked = [played("pass.csv", voltage[stretch], y[stretch], begin + time)]
        drive = plan(MODEL, wanted, 1e-3, LIMITS, periodic=True, tracked=tracked)
        np.testing.assert_array_equal(drive.voltage, learned[1])
    np.testing.assert_allclose(learned[1], learned[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "is_loop"),
    [
        ({"start": 0.0}, False),
        ({"start": 35.0}, False),
        ({"start": 0.0, "approach": "auto"}, True),
        ({"passes": 1}, True),
        ({"start": 0.0, "passes": 2}, True),
    ],
)
def test_a_pass_that_went_as_planned_changes_nothing(options, is_loop):
    """The model believes of a drive what it was made for: the same past, whatever led to it."""
    model = actuator(tau=(0.02,), gain=(0.02,))
    phase = 2 * np.pi * np.arange(500) / 500
    wanted, limits = 5.0 - 0.6 * np.cos(phase), Limits.within(model.input)
    options = {**options, "periodic": is_loop}
    drive = plan(model, wanted, 1e-3, limits, **options)
    period = drive.voltage[drive.move]
    voltage = np.concatenate([drive.voltage, np.tile(period, 4 if is_loop else 0)])
    before = options.get("start", voltage[0])
    y = believed(model, before, voltage)
    time = drive.time[0] + 1e-3 * np.arange(voltage.size)
    tracked = [played("pass.csv", voltage, y, time)]
    again = plan(model, wanted, 1e-3, limits, **options, tracked=tracked, absolute=True)
    np.testing.assert_allclose(again.voltage, drive.voltage, rtol=0, atol=1e-6)


def believed(model, before, voltage):
    """Return what a model makes of a drive behind a rest at a voltage."""
    rows = np.concatenate([[before], voltage])
    return model.run(rows, model.start(before), 1e-3).y[1:]
