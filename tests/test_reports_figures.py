"""What figures are drawn from, and that the same values give the same bytes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trials import pairs

from dbo_cli.errors import OutputError, cleaned
from dbo_cli.hysteresis.dynamics import DynamicsStage, Lag, Resonance
from dbo_cli.hysteresis.model import ActuatorModel, PointStage, Quantity, ScaleStage
from dbo_cli.hysteresis.operators import DiscreteBacklashOperator
from dbo_cli.reports import drawing
from dbo_cli.reports.accumulators import (
    BUCKETS,
    PIXELS,
    WHOLE,
    Band,
    Curve,
    Envelope,
    ErrorDistribution,
    FigureData,
    Pixels,
    Raster,
    Spectrum,
)
from dbo_cli.reports.drawing import check_folder, draw, file_stems, save
from dbo_cli.reports.figures import (
    label_decades,
    plots_of_channels,
    plots_of_comparison,
    plots_of_log,
    row_width,
)
from dbo_cli.reports.models import loop_of, plots_of_model
from dbo_cli.reports.renderers import breakable, to_html
from dbo_cli.reports.report import Report, ReportOptions, evaluate
from dbo_cli.reports.sample_pairs import BATCH


def log_of(samples, chunk=65536, drive=True, spike=None, options=None, unit="um"):
    """Return report and figure_data of a sine with a phase lag, noise and, at one sample, a spike."""
    time = np.arange(samples) / 1000.0
    desired = 20.0 * np.sin(2.0 * np.pi * time)
    measured = 20.0 * np.sin(2.0 * np.pi * time - 0.1) + np.random.default_rng(
        1
    ).normal(0.0, 0.1, samples)
    if spike is not None:
        measured[spike] += 50.0
    figure_data = FigureData("V")
    parts = (slice(start, start + chunk) for start in range(0, samples, chunk))
    blocks = (
        pairs(
            range(samples)[part],
            desired[part],
            measured[part],
            time[part],
            desired[part] / 20 if drive else None,
        )
        for part in parts
    )
    options = options or ReportOptions()
    log = evaluate("run.csv", blocks, options, figure_data=figure_data)
    return Report.of([log], options, unit), figure_data


def model(gears=5, points=3):
    rng = np.random.default_rng(2)
    stages = [
        DiscreteBacklashOperator(
            rng.uniform(0.2, 1.0, gears), np.sort(rng.uniform(0.2, 1.0, gears))
        )
    ]
    if points:
        stages.append(
            PointStage(rng.uniform(0.5, 1.0, points), rng.uniform(0.5, 1.0, points))
        )
    stages.append(ScaleStage(12.53, -22.97))
    return ActuatorModel(
        "forward",
        Quantity("voltage", "V", 0.0, 3.6),
        Quantity("displacement", "um", -23.0, 23.0),
        tuple(stages),
    )


class TestEnvelope:
    @pytest.mark.parametrize("samples", [1, 9, BUCKETS, BUCKETS + 1, BATCH, 200_001])
    def test_keeps_the_extremes(self, samples):
        values = np.cumsum(np.random.default_rng(samples).normal(size=samples))
        envelope = Envelope()
        for start in range(0, samples, BATCH):
            part = slice(start, min(start + BATCH, samples))
            envelope.add(np.arange(part.start, part.stop, dtype=float), [values[part]])
        band = envelope.band(0)
        assert len(band.x) <= BUCKETS
        assert (band.low.min(), band.high.max()) == (values.min(), values.max())
        assert np.all(band.low <= band.high)
        assert np.all(np.diff(band.x) >= 0.0)

    def test_stretches_are_even_and_each_keeps_its_own_extremes(self):
        values = np.random.default_rng(0).normal(size=131072)
        envelope = Envelope()
        for part in np.split(values, 131072 // BATCH):
            envelope.add(np.zeros(BATCH), [part])
        stretches = values.reshape(2048, 64)
        band = Band(np.zeros(2048), stretches.min(axis=1), stretches.max(axis=1))
        assert np.array_equal(envelope._done[0, 1], band.low)
        assert np.array_equal(envelope._done[0, 3], band.high)

    def test_many_cycles_become_their_envelope(self):
        x = np.arange(2048.0)
        wave = np.sin(2.0 * np.pi * x / 4.7)
        band = Band(x, wave - 0.1, wave + 0.1).smooth()
        assert len(band.x) <= 512
        assert band.high.min() > 0.8
        assert Band(x, x - 1.0, x + 1.0).smooth().x is x


class TestPixels:
    @pytest.mark.parametrize("growth", [1.0, 1e3, 1e-3])
    def test_every_sample_lies_on_a_passed_pixel(self, growth):
        rng = np.random.default_rng(7)
        x = rng.normal(size=20000) * np.geomspace(1.0, growth, 20000)
        y = rng.normal(size=20000) * np.geomspace(1.0, growth, 20000) - 96.0
        pixels = Pixels()
        for part in np.split(np.arange(20000), 10):
            pixels.add(x[part], y[part])
        raster = pixels.raster()
        left, right, bottom, top = raster.extent
        rows, columns = raster.passed.shape
        assert max(rows, columns) <= PIXELS
        column = ((x - left) / (right - left) * columns).astype(int)
        row = ((y - bottom) / (top - bottom) * rows).astype(int)
        assert raster.passed[row, column].all()

    def test_a_spike_is_drawn_all_the_way(self):
        x = np.linspace(0.0, 1.0, 60000)
        y = np.zeros(60000)
        y[30000] = 1.0
        pixels = Pixels()
        pixels.add(x, y)
        assert pixels.raster().passed.any(axis=1).sum() > 500

    def test_the_way_from_one_batch_to_the_next_is_drawn(self):
        pixels = Pixels()
        pixels.add(np.zeros(50), np.zeros(50))
        pixels.add(np.ones(50), np.ones(50))
        assert pixels.raster().passed.sum() > 500


def test_the_windows_of_a_spectrum_overlap_from_one_batch_into_the_next():
    noise = np.random.default_rng(8).normal(size=2 * BATCH)
    whole, cut = Spectrum(), Spectrum()
    whole.add(noise)
    for part in np.split(noise, 2):
        cut.add(part)
    first, second = whole.density(1e-3), cut.density(1e-3)
    assert first is not None and second is not None
    assert second.y == pytest.approx(first.y, rel=1e-12)


def test_spectrum_of_white_noise_and_of_a_tone():
    rate = 1000.0
    noise = np.random.default_rng(3).normal(0.0, 0.5, 400_000)
    spectrum = Spectrum()
    for part in np.array_split(
        noise + 2.0 * np.sin(2.0 * np.pi * 125.0 * np.arange(400_000) / rate) + 7.0, 7
    ):
        spectrum.add(part)
    curve = spectrum.density(1.0 / rate)
    assert curve is not None
    assert curve.x[np.argmax(curve.y)] == pytest.approx(125.0, abs=0.25)
    # white noise of deviation s has the one-sided density s sqrt(2/rate)
    assert np.median(curve.y) == pytest.approx(0.5 * np.sqrt(2.0 / rate), rel=0.05)
    assert Spectrum().density(1.0) is None


@pytest.mark.parametrize("samples", [500, WHOLE, WHOLE + 1, 200_000])
def test_figure_data_do_not_depend_on_the_chunk_size(samples):
    _, whole = log_of(samples)
    _, cut = log_of(samples, chunk=997)
    for name in ("desired", "measured", "error", "drive"):
        first, second = whole.against_time(name), cut.against_time(name)
        assert isinstance(first, Curve) == (samples <= WHOLE)
        assert all(
            np.array_equal(a, b)
            for a, b in zip(vars(first).values(), vars(second).values(), strict=True)
        )
    for pair in (("desired", "measured"), ("drive", "measured")):
        first, second = whole.against(*pair), cut.against(*pair)
        if isinstance(first, Raster):
            assert first.extent == second.extent
            assert np.array_equal(first.passed, second.passed)


def test_the_offset_is_taken_off_the_pixels_of_a_long_log():
    from matplotlib.figure import Figure

    desired = 20.0 * np.sin(np.arange(20_000) / 300.0)
    data, options = FigureData("V"), ReportOptions(remove_offset=True)
    block = pairs(range(1, 20_001), desired, desired + 1000.0, None, desired)
    log = evaluate("far.csv", [block], options, figure_data=data)
    for plot in plots_of_log(Report.of([log], options, "um"), log, data):
        if plot.key in ("output", "loop"):
            axes = Figure().add_subplot()
            plot.paint(axes)
            [image] = axes.images
            assert image.get_extent() == pytest.approx(
                (-20.0, 20.0, -20.0, 20.0), abs=0.2
            )


def test_one_spike_in_a_long_log_is_kept():
    _, figure_data = log_of(300_000, spike=123_456)
    band = figure_data.against_time("error")
    assert isinstance(band, Band)
    assert band.high.max() > 45.0
    assert band.x[np.argmax(band.high)] == pytest.approx(123.456, abs=1.0)


def test_figures_of_a_log():
    report, figure_data = log_of(3000)
    keys = [plot.key for plot in plots_of_log(report, report.logs[0], figure_data)]
    assert keys == [
        "tracking",
        "worst",
        "error",
        "output",
        "loop",
        "histogram",
        "spectrum",
        "drive",
    ]
    report, figure_data = log_of(3000, drive=False)
    keys = [plot.key for plot in plots_of_log(report, report.logs[0], figure_data)]
    assert keys == ["tracking", "worst", "error", "output", "histogram", "spectrum"]
    report, figure_data = log_of(1)
    assert len(plots_of_log(report, report.logs[0], figure_data)) == 7


@pytest.mark.parametrize(
    ("samples", "kind"), [(3000, "svg"), (20_000, "png"), (20_000, "inline")]
)
def test_same_values_same_bytes(samples, kind):
    """Every figure in one of the three forms."""
    forms = ("svg", "png", "inline")
    drawn = []
    for _ in range(2):
        report, figure_data = log_of(samples)
        plots = plots_of_log(report, report.logs[0], figure_data)
        drawn.append([draw(plot, kind) for plot in plots[forms.index(kind) :: 3]])
    assert drawn[0] == drawn[1] != []


def test_axes_carry_quantity_and_unit():
    report, figure_data = log_of(3000)
    texts = {
        plot.key: re.findall(
            r"<text[^>]*>([^<]+)</text>", draw(plot, "inline").decode()
        )
        for plot in plots_of_log(report, report.logs[0], figure_data)
    }
    assert {"Time (s)", "Displacement (µm)", "desired", "measured"} <= set(
        texts["tracking"]
    )
    assert {"Time (s)", "Error (µm)"} <= set(texts["error"])
    assert {"Desired displacement (µm)", "Measured displacement (µm)"} <= set(
        texts["output"]
    )
    assert {"Drive voltage (V)", "Displacement (µm)"} <= set(texts["loop"])
    assert {"Frequency (Hz)", "Error density (µm/√Hz)"} <= set(texts["spectrum"])
    assert {"Error (µm)", "Share of samples (%)"} <= set(texts["histogram"])


def test_logarithmic_axes_are_labelled_in_plain_letters() -> None:
    drawn = []
    for (report, data), seen in (
        (log_of(3000), {"spectrum"}),
        (log_of(3000, spike=7), {"histogram"}),
    ):
        plots = {plot.key: plot for plot in plots_of_log(report, report.logs[0], data)}
        drawn += [draw(plots[key], "inline").decode() for key in seen]
    report, data = swept_log(20.0)
    drawn += [
        draw(plot, "inline").decode()
        for plot in plots_of_log(report, report.logs[0], data)
    ]
    labels = [
        label
        for text in drawn
        for label in re.findall(r"<text[^>]*>([^<]+)</text>", text)
    ]
    assert not [label for label in labels if "$" in label or "\\" in label]
    # the sweep spans less than two powers of ten
    assert {"2", "3", "5", "10", "20"} <= set(labels)


@pytest.mark.parametrize(
    "ends", [(0.61, 0.95), (1.05, 1.9), (0.0004, 0.0009), (3.0, 40.0), (1e-7, 1.0)]
)
def test_every_logarithmic_axis_has_labels(ends: tuple[float, float]) -> None:
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    axes.set_xscale("log")
    axes.set_xlim(*ends)
    label_decades(axes.xaxis)
    ticks = [*axes.xaxis.get_ticklabels(), *axes.xaxis.get_ticklabels(minor=True)]
    shown = [
        one.get_text() for one in ticks if ends[0] <= one.get_position()[0] <= ends[1]
    ]
    labels = [text for text in shown if text]
    assert 2 <= len(labels) <= 12 and len(set(labels)) == len(labels)


def test_a_constant_log_can_be_drawn():
    figure_data = FigureData()
    block = pairs(range(1, 101), np.full(100, 2.0), np.full(100, 2.0))
    log = evaluate("flat.csv", [block], ReportOptions(), figure_data=figure_data)
    report = Report.of([log], ReportOptions(), None)
    for plot in plots_of_log(report, log, figure_data):
        assert draw(plot, "svg").startswith(b"<?xml")


def test_inline_figures_share_no_id_and_take_the_colours_of_the_page():
    report, figure_data = log_of(3000)
    plots = plots_of_log(report, report.logs[0], figure_data)
    page = to_html(
        Report.of([report.logs[0]] * 2, report.options, "um"),
        [plots, plots],
        model_plots=plots_of_model(model()),
        program="dbo",
    )
    ids = re.findall(r' id="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(#|href="#)([^)"]+)', page)) <= set(ids)
    figures = page[page.index("<body>") :]
    assert not re.search(r"(fill|stroke): #(1b1d22|00508f|e0751a|d5d9df)", figures)
    assert "var(--first)" in figures
    for figure in re.findall(r"<svg.*?</svg>", page, re.DOTALL):
        ElementTree.fromstring(figure)


def test_page_is_self_contained_and_the_same_each_time():
    report, figure_data = log_of(3000)
    plots = plots_of_log(report, report.logs[0], figure_data)
    page = to_html(report, [plots], title="A < B & C", program="dbo < 1")
    assert page == to_html(report, [plots], title="A < B & C", program="dbo < 1")
    assert (
        "<title>A &lt; B &amp; C</title>" in page
        and "<footer>dbo &lt; 1</footer>" in page
    )
    assert "<script" not in page
    outside = [
        link
        for link in re.findall(r'(?:src|href)="([^"]*)"', page)
        if link[:1] != "#" and link[:5] != "data:"
    ]
    assert outside == []
    assert "url(http" not in page
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page


def test_page_and_style_sheet_have_the_colours_of_the_figures():
    folder = Path(drawing.__file__).parent
    light = (folder / "page.css").read_text().partition("@media")[0]
    variables = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", light))
    assert {variables[name]: name for name in drawing.SCHEME.values()} == drawing.SCHEME
    used = set(
        re.findall(
            r"color: ([0-9a-f]{6})$",
            (folder / "figures.mplstyle").read_text(),
            re.MULTILINE,
        )
    )
    assert {f"#{one}" for one in used} == {drawing.INK, drawing.MUTED, drawing.RULE}


def test_figures_of_a_model_in_both_directions():
    assert [plot.key for plot in plots_of_model(model())] == [
        "gears",
        "slopes",
        "points",
    ]
    assert [plot.key for plot in plots_of_model(model(points=0).inverse())] == [
        "gears",
        "slopes",
    ]
    bent = model()
    bent = replace(bent, stages=(PointStage([1.0, 2.6], [1.5, 2.1]), *bent.stages))
    assert [plot.key for plot in plots_of_model(bent)] == [
        "gears",
        "slopes",
        "points-before",
        "points",
    ]
    assert [plot.key for plot in plots_of_model(bent.inverse())][2:] == [
        "points",
        "points-after",
    ]
    text = draw(plots_of_model(model())[0], "inline").decode()
    assert "Voltage (V)" in text
    for plot in plots_of_model(model().inverse()):
        assert draw(plot, "png") == draw(plot, "png")


def test_loop_of_the_gears_is_what_the_operator_does():
    operator = model().backlash
    up_x, up_y, down_x, down_y = loop_of(operator)
    y, state, _ = operator.run(up_x, operator.empty())
    assert y == pytest.approx(up_y, abs=1e-12)
    assert operator.run(down_x, state)[0] == pytest.approx(down_y, abs=1e-12)


def test_saved_figures(tmp_path):
    report, figure_data = log_of(2000)
    plots = plots_of_log(report, report.logs[0], figure_data)
    folder = check_folder(str(tmp_path / "new" / "figures"))
    written = save(plots[:2], folder, "run", "run.csv")
    assert sorted(os.listdir(folder)) == [
        "run-tracking.png",
        "run-tracking.svg",
        "run-worst.png",
        "run-worst.svg",
    ]
    assert [path.name for path in written][:2] == [
        "run-tracking.png",
        "run-tracking.svg",
    ]
    assert written[0].read_bytes()[:4] == b"\x89PNG"
    for plot, (png, svg) in zip(plots[:2], (written[:2], written[2:]), strict=True):
        assert png.read_bytes() == draw(plot, "png", "run.csv")
        assert svg.read_bytes() == draw(plot, "svg", "run.csv")


def test_unwritable_figure_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError) as caught:
        check_folder(str(tmp_path / "file" / "figures"))
    assert str(caught.value) == (
        f"{tmp_path}/file/figures: figures cannot be written there: Not a directory"
        " (`figures` with another folder)"
    )


def test_file_stems_are_different_and_plain():
    names = [
        "a/run.csv",
        "b/run.csv",
        "run.h5::/trial 1",
        "-",
        "µ m.csv",
        "run.csv.gz",
        "Run.CSV",
    ]
    assert file_stems(names) == [
        "run",
        "run-2",
        "run-trial_1",
        "stdin",
        "µ_m",
        "run-3",
        "Run-4",
    ]


def test_file_stems_tell_what_the_names_tell():
    names = [
        "run.1.csv",
        "run.2.csv",
        "run.10.csv.gz",
        "2024-05-02T10.30",
        "駆動.csv",
        ".csv",
        "a\\b c.dat",
    ]
    assert file_stems(names) == [
        "run.1",
        "run.2",
        "run.10",
        "2024-05-02T10.30",
        "駆動",
        "csv",
        "b_c",
    ]


@pytest.mark.parametrize("letter", ["x", "駆", "𝄞"])
def test_file_stems_of_long_names_leave_room_in_255_bytes(letter):
    name = letter * (239 // len(letter.encode()))
    first, second = file_stems([f"{name}1.csv", f"{name}2.csv"])
    assert first != second
    assert (
        max(len(f"{stem}-points-before.png".encode()) for stem in (first, second)) < 160
    )


HOSTILE = [
    "$x_1$.csv",
    "$\\frac{.csv",
    "_hidden.csv",
    "駆動.csv",
    "\x1b[31mred.csv",
    "<b>&.csv",
    "x" * 239 + ".csv",
]


def reports_of(names, unit="$\\um_1$"):
    options = ReportOptions()
    logs, figure_data = [], []
    for number, name in enumerate(names):
        report, seen = log_of(2000 if number % 2 else 10_000, unit=unit)
        logs.append(replace(report.logs[0], name=cleaned(name)))
        figure_data.append(seen)
    return Report.of(logs, options, unit), figure_data


@pytest.mark.parametrize("kind", ["png", "svg", "inline"])
def test_names_and_units_are_drawn_as_they_are_written(kind):
    report, figure_data = reports_of(HOSTILE[:6])
    plots = plots_of_comparison(report, figure_data) + plots_of_log(
        report, report.logs[0], figure_data[0]
    )
    drawn = {
        plot.key: draw(plot, kind, note="$x_1$ 駆動 \x1b[0m") for plot in plots[:3]
    }
    if kind == "inline":
        shown = "".join(ElementTree.fromstring(drawn["errors"].decode()).itertext())
        for name in (
            "$x_1$.csv",
            "$\\frac{.csv",
            "_hidden.csv",
            "駆動.csv",
            "[31mred.csv",
            "<b>&.csv",
        ):
            assert name in shown
        assert "Error ($\\um_1$)" in shown


def test_a_long_name_is_cut_to_fit_the_figure():
    report, figure_data = log_of(500)
    plot = plots_of_log(report, report.logs[0], figure_data)[0]
    texts = re.findall(
        r"<text[^>]*>([^<]+)</text>",
        draw(plot, "inline", note="a" * 200 + ".csv").decode(),
    )
    assert [len(text) for text in texts if text.startswith("aaa")] == [40]
    assert any(text.endswith("a.csv") for text in texts)


def test_errors_of_all_logs_stand_in_one_figure():
    report, figure_data = reports_of(["before.csv", "after.csv"], "um")
    [plot] = plots_of_comparison(report, figure_data)
    assert (plot.key, plot.title, plot.head) == (
        "errors",
        "Error of all logs against time",
        0.0,
    )
    texts = re.findall(r"<text[^>]*>([^<]+)</text>", draw(plot, "inline").decode())
    assert {"before.csv", "after.csv", "Error (µm)", "Time (s)"} <= set(texts)
    assert plots_of_comparison(*reports_of(["alone.csv"])) == []
    report, figure_data = reports_of(
        [f"recording_number_{k}_of_many.csv" for k in range(8)], "um"
    )
    [plot] = plots_of_comparison(report, figure_data)
    assert plot.title == "Error of the first 6 of 8 logs against time"
    assert plot.head == pytest.approx(5 * 0.17)
    own = plots_of_log(report, report.logs[0], figure_data[0])[1]
    page = to_html(report, [[own], *[[]] * 7], comparison_plots=[plot], program="dbo")
    assert page.count("<section>") == 1  # a log without figures and segments needs none
    assert page.index("Error of the first 6") < page.index("<section>")


def test_logs_that_begin_at_different_times_are_drawn_from_their_own_beginning():
    report, figure_data = reports_of(["a.csv", "b.csv"], "um")
    figure_data[1]._whole["time"] += 1000.0
    figure_data[1].start += 1000.0
    [plot] = plots_of_comparison(report, figure_data)
    texts = re.findall(r"<text[^>]*>([^<]+)</text>", draw(plot, "inline").decode())
    assert "Time since each log began (s)" in texts
    assert not any(text.startswith("10") and len(text) >= 4 for text in texts)


def test_short_names_do_not_break_on_the_page_and_long_ones_behind_a_separator():
    assert (
        breakable("compensated_run_1.csv")
        == '<span class="name">compensated_run_1.csv</span>'
    )
    pieces = re.findall(
        r">([^<]+)</span>", breakable("recordings/2024-05-02/a-rather-long-name_3.csv")
    )
    assert "".join(pieces) == "recordings/2024-05-02/a-rather-long-name_3.csv"
    assert "name_" in pieces and "2024-" in pieces
    assert max(map(len, re.findall(r">([^<]+)</span>", breakable("x" * 239)))) == 28
    assert "<b>" not in breakable("<b>" * 30)


class TestEnvironment:
    """Figures are drawn, silently, wherever the program is started."""

    SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
from test_reports_figures import log_of
from dbo_cli.reports.drawing import draw
from dbo_cli.reports.figures import plots_of_comparison, plots_of_log
report, figure_data = log_of(500)
data = draw(plots_of_log(report, report.logs[0], figure_data)[0], "png", note="駆動")
print(len(data))
"""

    def run(self, tmp_path, **environment):
        temporary = tmp_path / "temporary"
        temporary.mkdir()
        script = self.SCRIPT.format(tests=os.path.dirname(__file__))
        given = {**os.environ, "TMPDIR": str(temporary), **environment}
        done = subprocess.run(
            [sys.executable, "-c", script], env=given, capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")
        assert int(done.stdout) > 1000
        assert os.listdir(temporary) == []

    @pytest.mark.parametrize(
        "backend", ["module://matplotlib_inline.backend_inline", "nonsense", "tkagg"]
    )
    def test_a_notebooks_backend(self, tmp_path, backend):
        self.run(tmp_path, MPLBACKEND=backend)

    def test_a_configuration_folder_that_cannot_be_made(self, tmp_path):
        (tmp_path / "file").write_text("")
        self.run(tmp_path, MPLCONFIGDIR=str(tmp_path / "file" / "folder"))

    def test_a_home_that_cannot_be_written(self, tmp_path):
        (tmp_path / "file").write_text("")
        home = str(tmp_path / "file" / "home")
        self.run(
            tmp_path, HOME=home, XDG_CONFIG_HOME="", XDG_CACHE_HOME="", MPLCONFIGDIR=""
        )

    def test_the_users_own_settings_change_nothing(self, tmp_path, monkeypatch):
        report, figure_data = log_of(500)
        plot = plots_of_log(report, report.logs[0], figure_data)[0]
        before = draw(plot, "svg")
        import matplotlib

        with matplotlib.rc_context(
            {"lines.linewidth": 9.0, "axes.spines.top": True, "font.size": 30.0}
        ):
            assert draw(plot, "svg") == before
            assert matplotlib.rcParams["font.size"] == 30.0


def swept_log(to: float) -> tuple[Report, FigureData]:
    """Return a report by cycles of a sweep from 1 Hz whose error grows with the square of the frequency."""
    time = np.arange(20_000) / 1000.0
    frequency = np.geomspace(1.0, to, time.size)
    desired = 10.0 * np.sin(2.0 * np.pi * np.cumsum(frequency) / 1000.0)
    figure_data = FigureData(None)
    block = pairs(
        range(time.size), desired, desired * (1.0 + 1e-3 * frequency**2), time, None
    )
    options = ReportOptions(segment="cycles")
    log = evaluate("sweep.csv", [block], options, figure_data=figure_data)
    return Report.of([log], options, "um"), figure_data


def test_the_error_is_drawn_against_frequency_where_segments_differ_in_it() -> None:
    report, data = swept_log(20.0)
    log = report.logs[0]
    found = [(part.figures.frequency, part.figures.rmse) for part in log.segments[1:-1]]
    for frequency, rmse in found:
        assert frequency is not None
        assert rmse == pytest.approx(1e-3 * frequency**2 * 10.0 / np.sqrt(2.0), rel=0.2)
    plots = {plot.key: plot for plot in plots_of_log(report, log, data)}
    assert b"<svg" in draw(plots["frequency"], "svg")
    assert "frequency_hz" in report.logs[0].segments[0].record()
    report, data = swept_log(1.2)
    assert "frequency" not in {
        plot.key for plot in plots_of_log(report, report.logs[0], data)
    }


def test_the_response_of_a_model_with_dynamics_is_drawn_with_what_was_measured() -> (
    None
):
    gears = DiscreteBacklashOperator([1.0, 1.0], [1.0, 2.0], 0.0, 0.0)
    quantities = (
        Quantity("voltage", "V", 0.0, 2.0),
        Quantity("displacement", "um", 0.0, 3.0),
    )
    lag, mode = DynamicsStage((Lag(1e-3),)), DynamicsStage((Resonance(100.0, 0.05),))
    response = {
        "frequency": [10.0, 99.0, 150.0],
        "gain": [2.0, 18.0, 1.6],
        "phase_degrees": [-5.0, -100, -190],
    }
    for fit in (
        {},
        {"dynamics": {"response": response}, "trusted_hz": 70.0},
        {"dynamics": {"response": 3}},
    ):
        model = ActuatorModel("forward", *quantities, (lag, gears, mode), fit)
        for one in (model, model.inverse()):
            plots = {plot.key: plot for plot in plots_of_model(one)}
            shown = {
                key: draw(plots[key], "inline").decode()
                for key in ("bode", "bode-phase")
            }
            for text in shown.values():
                assert "model" in text and ("trusted up to" in text) == (
                    "trusted_hz" in fit
                )
                assert (
                    "measured"
                    in re.sub(r"<title.*?</title>|aria-label=\"[^\"]*\"", "", text)
                ) == ("trusted_hz" in fit)
    bare = ActuatorModel("forward", *quantities, (gears,))
    assert "bode" not in {plot.key for plot in plots_of_model(bare)}


def report_of(names, percents, unit="um"):
    """Return a report on channels of these RMSE, in % of a range of 10."""
    one = log_of(100)[0].logs[0]
    logs = []
    for name, percent in zip(names, percents, strict=True):
        rmse = 1.0 if percent is None else percent / 10.0
        logs.append(
            replace(
                one,
                name=name,
                figures=replace(one.figures, rmse=rmse, nrmse_percent=percent),
            )
        )
    return Report.of(logs, ReportOptions(), unit)


def painted(plot):
    from matplotlib.figure import Figure

    axes = Figure().add_axes((0.1, 0.1, 0.8, 0.8))
    plot.paint(axes)
    return axes


@pytest.mark.parametrize(
    "count, spread", [(1, 0.0), (3, 1.0), (128, 1.0), (128, 100.0)]
)
def test_the_bars_of_a_histogram_add_up_to_the_channels(count, spread):
    percents = 1.0 + spread * np.random.default_rng(4).uniform(0.0, 1.0, count)
    report = report_of(map(str, range(1, count + 1)), percents)
    for plot, unit, values in zip(
        plots_of_channels(report),
        ("% of the move", "µm"),
        (percents, percents / 10),
        strict=False,
    ):
        axes = painted(plot)
        assert sum(bar.get_height() for bar in axes.patches) == count
        assert axes.get_xlabel() == f"RMSE ({unit})"
        assert axes.get_xscale() == ("log" if spread > 30.0 else "linear")
        assert [line.get_xdata()[0] for line in axes.lines] == [
            np.median(values),
            values.max(),
        ]


def test_a_map_of_numbered_channels_leaves_those_that_failed_blank():
    names = [str(k) for k in (9, *range(1, 5), *range(6, 9), *range(10, 33))]
    percents = [7.5, *np.linspace(1.0, 2.0, len(names) - 1)]
    *_, plot = plots_of_channels(report_of(names, percents))
    axes = painted(plot)
    cells = axes.images[0].get_array()
    assert (
        cells.shape == (4, 8) and plot.key == "map" and "8 numbers a row" in plot.title
    )
    assert np.flatnonzero(cells.mask).tolist() == [4]  # 5 is missing
    assert (cells[1, 0], axes.patches[0].get_xy()) == (7.5, (-0.5, 0.5))  # 9, the worst
    assert "worst: 9, 7.50 %, 0.750 µm" in plot.words
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        "1",
        "9",
        "17",
        "25",
    ]


def test_few_or_named_channels_are_bars_in_their_order():
    *_, plot = plots_of_channels(report_of(["10", "2", "1"], [3.0, 2.0, None]))
    axes = painted(plot)
    others, worst = (bars.get_data().values[::2] for bars in axes.patches)
    assert (others.tolist(), worst.tolist()) == ([0.0, 2.0, 0.0], [0.0, 0.0, 3.0])
    assert [text.get_text() for text in axes.texts] == ["1", "2", "10"]
    *_, plot = plots_of_channels(
        report_of([f"long name of {k}" for k in range(300)], np.ones(300))
    )
    assert len(painted(plot).texts) < 10
    # no range: in the unit
    histogram, plot = plots_of_channels(report_of(["x", "y"], [None, None], None))
    assert (painted(plot).get_ylabel(), painted(histogram).get_xlabel()) == (
        "RMSE",
        "RMSE",
    )
    assert plot.words == "A bar a channel; worst: x, 1.00."


def test_rows_of_a_map_are_full_where_they_can_be():
    assert [row_width(count) for count in (12, 25, 97, 127, 128, 5000)] == [
        4,
        5,
        10,
        12,
        16,
        100,
    ]


def test_rows_whose_drive_is_no_number_are_drawn_nowhere() -> None:
    """A pause that a log's voltage shows as NaN leaves the other rows where they are."""
    desired = np.linspace(0.0, 9.9, 100)
    voltage = 10.0 * desired
    voltage[[0, 3, 50]] = np.nan
    data = FigureData("V")
    data.add(
        pairs(np.arange(1, 101), desired, desired + 0.1, 0.01 * np.arange(100), voltage)
    )
    data.finish(ErrorDistribution())
    assert (data.samples, data.has_drive) == (97, True)
    assert data.start == 0.01
    drive = data.against_time("drive")
    assert isinstance(drive, Curve)
    assert drive.y.tolist() == np.delete(voltage, [0, 3, 50]).tolist()
    assert (
        data.against_time("measured").y.tolist()
        == np.delete(desired + 0.1, [0, 3, 50]).tolist()
    )


@pytest.mark.parametrize(
    "name", ["run.csv", "scan_of_sample_17_after_conditioning_2026-11-24.csv"]
)
def test_a_file_name_and_a_legend_never_lie_on_one_another(name):
    report, figure_data = log_of(2000, spike=3)
    with drawing.styled():
        for plot in plots_of_log(report, report.logs[0], figure_data):
            figure = drawing._painted(plot, name, as_outlines=True)
            figure.canvas.draw()
            axes = figure.axes[0]
            note = axes.title if axes.title.get_text() else axes._right_title
            legend, bounds = axes.get_legend(), figure.bbox
            box = note.get_window_extent()
            assert (
                bounds.x0 <= box.x0 and box.x1 <= bounds.x1 and box.y1 <= bounds.y1
            ), plot.key
            if legend is not None:
                named = legend.get_window_extent()
                assert not box.overlaps(named), plot.key
                assert named.x1 <= bounds.x1 and named.y1 <= bounds.y1, plot.key


def test_the_finer_figure_shows_the_log_and_nothing_beside_it():
    report, figure_data = log_of(2000, spike=3)
    plots = {
        plot.key: plot for plot in plots_of_log(report, report.logs[0], figure_data)
    }
    with drawing.styled():
        finer = (
            drawing._painted(plots["worst"], "", as_outlines=True).axes[0].get_xlim()
        )
    margin = 0.02  # s, of a log of 2 s
    assert -margin < finer[0] < 0.003
    assert finer[1] - finer[0] == pytest.approx((2.0 + 2.0 * margin) / 10.0, rel=0.02)
