"""What the recording of a bench shows: pulses, motion over time, a figure. Times of the MD3 are those of its user guide."""

import sys

import pytest
from matplotlib.figure import Figure
from modbus import read, write

import drivetwin
from drivetwin import Bench, Error, UnknownName, _plot


def moved():
    """10,000 steps at 5,000 steps/s and 10,000 steps/s\u00b2: half a second up, 1.5 s, half a second down."""
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True)
    bench.run_until(1.0)
    x.registers["MotionControl"] = 1
    bench.run_until(4.0)
    return bench, x


def test_a_history_is_exact():
    bench, x = moved()
    history = [tuple(row) for row in bench.history(x).tolist()]
    assert history[0] == (0.0, 0, 0.0) and history[-1] == (4.0, 10_000, 0.0)
    assert history == sorted(history, key=lambda row: row[0]) and len(history) == len(set(history))
    begin = next(at for at, _, speed in history if speed > 0) - 0.001
    assert begin == pytest.approx(1.0, abs=0.002)
    top = [row for row in history if row[2] == 5_000.0]
    assert top[0][0] == pytest.approx(begin + 0.5, abs=0.002) and top[0][1] == pytest.approx(1_250, abs=2)
    assert top[-1][0] == pytest.approx(begin + 2.0, abs=0.002) and top[-1][1] == pytest.approx(8_750, abs=2)
    # One sample in each millisecond of 2.5 s, and the ends of the ramps.
    assert 2_500 <= len(history) <= 2_520
    # A bench that stops at a sample moves as the history says.
    again = Bench()
    y = again.add("md3", name="x", fast_boot=True)
    again.run_until(1.0)
    y.registers["MotionControl"] = 1
    for at, position, speed in [row for row in history[1::97] if row[0] > 1.0]:
        again.run_until(at)
        assert (y.motion.position, y.motion.speed) == (position, speed)
    assert len(bench.history("x", every=0.1)) < 50


def test_a_history_of_a_motor_of_an_rs():
    bench = Bench()
    rs = bench.add("rs434544", name="rs")
    bench.advance(1.0)
    for register, value in {"MODE_ROTATION": 2, "OFFSET": 200, "START_bit": 1}.items():
        rs.registers[register] = value
    bench.advance(3.0)
    history = bench.history(rs)
    assert history["position"][-1] == rs.motion.position >= 190 and history["at"][-1] == bench.now
    assert len(history) > 20 and history["speed"].max() > 100


def test_lists_without_numpy(monkeypatch):
    bench, x = moved()
    arrays = bench.history(x), x.pulses()
    assert arrays[0].dtype.names == ("at", "position", "speed") and arrays[1].dtype.names == ("at", "step")
    arrays[0]["position"] += 1
    monkeypatch.setitem(sys.modules, "numpy", None)
    lists = bench.history(x), x.pulses()
    assert [type(rows) for rows in lists] == [list, list] and type(lists[0][0]) is tuple
    assert [(at, position - 1, speed) for at, position, speed in arrays[0].tolist()] == lists[0]
    assert arrays[1].tolist() == lists[1] and len(lists[1]) == 10_000


def test_pulses_and_history_over_a_power_cycle():
    bench, x = moved()
    off = bench.now
    x.power("cycle")
    bench.advance(3.0)
    assert len(x.pulses()) == 0
    x.registers["MotionControl"] = 1
    bench.advance(3.0)
    pulses = x.pulses()
    assert len(pulses) == 10_000 and pulses["at"].min() > off
    history = bench.history(x)
    assert len(history[history["speed"] == 5_000.0]) > 2 * 1_500 and history["position"][-1] == 10_000


def test_what_has_no_history():
    bench = Bench()
    q, x = bench.add("qsb-d", name="q"), bench.add("md3", name="x")
    bench.run_until(20.0)
    # A bench at rest has few samples.
    assert len(bench.history(x, every=1e-6)) == 2
    bench.run_until(30_000.0)
    assert len(bench.history(x)) == 2
    x.registers["MotionControl"] = 2
    bench.advance(20.0)
    for act, error, sentence in [
        (lambda: bench.history(q), Error, "q moves nothing: qsb-d has no axis"),
        (lambda: bench.history("y"), UnknownName, None),
        (lambda: bench.history(x, every=0), Error, "every takes at least 0.000001 s, not 0"),
        (lambda: bench.history(x, every=1e-6), Error, "the history has more than 10000000 samples; take a greater every"),
        (lambda: bench.plot("y"), UnknownName, None),
        (lambda: bench.plot(start=5.0, end=1.0), Error, "the time axis begins at 5 s, so it cannot end at 1 s"),
        (lambda: bench.plot(start=-5.0), Error, "start takes seconds from 0 to 1000000000, not -5"),
    ]:  # fmt: skip
        with pytest.raises(error) as raised:
            act()
        assert sentence is None or str(raised.value) == sentence


def texts(figure):
    axes = [text.get_text() for axes in figure.axes for text in axes.texts]
    legends = [text for legend in figure.legends for text in legend.texts]
    return axes + [text.get_text() for text in figure.texts + legends]


def test_a_figure_shows_motion_frames_and_pins(tmp_path):
    bench, x = moved()
    x.line().faults(drop={"count": 1, "direction": "reply"})
    for frame in read(1, 0x14, 2), write(1, 0x0B, 5), write(1, 0x15, 9_000)[:-1] + b"\0":
        x.ask(frame)
    bench.add("qsb-d", name="q")
    bench.advance(1.0)
    figure = bench.plot(title="A move")
    shown = texts(figure)
    for wanted in [
        *("A move", "x", "US Digital MD3 stepper drive, 7 A", "position", "steps", "speed", "steps/s", "STEP", "rs485"),
        "write Reserved = 5 \u2192 refused: 0x000B Reserved is read only (02)",
        *("request", "answer", "refused", "not received", "by fault", "q"),
    ]:
        assert wanted in shown, wanted
    assert "without effect" not in shown
    position = next(axes for axes in figure.axes if "position" in [text.get_text() for text in axes.texts])
    assert max(position.lines[0].get_ydata()) == 10_000
    figure.savefig(tmp_path / "all.png")
    assert (tmp_path / "all.png").read_bytes()[1:4] == b"PNG"
    part = bench.plot(x, start=1.0, end=2.0)
    assert "q" not in texts(part) and part.axes[0].get_xlim() == (1.0, 2.0)
    assert Bench().plot().texts


def test_words_of_frames_do_not_overlap():
    bench, x = moved()
    for value in range(100):
        x.ask(write(1, 0x1D, value))
        x.ask(read(1, 0x14, 2))
        bench.advance(0.002)
    figure = bench.plot(x)
    figure.canvas.draw()
    frames = next(axes for axes in figure.axes if "rs485" in [text.get_text() for text in axes.texts])
    words = [text.get_window_extent() for text in frames.texts if text.get_text() not in ("rs485", "frames")]
    assert len(words) >= 10
    assert not any(a.overlaps(b) for place, a in enumerate(words) for b in words[:place])
    width = figure.bbox.width
    assert all(0 <= box.x0 and box.x1 <= width for box in words)


def test_pulses_narrower_than_a_column_are_not_levels():
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True, set={"Speed": 30})
    x.registers["MotionControl"] = 2  # jog forward
    bench.advance(100.0)
    # A column of the picture has 50 ms, and one or two pulses of 2 µs. Some of them begin in one and end in the next.
    (panel,) = bench._tracks([], None, None)
    (step,) = [track for track in panel["tracks"] if track["name"] == "STEP"]
    edges = step["edges"]
    assert len(edges) > 1_000
    step["edges"] = [(0.0, False, "0"), (9.99999, False, "1"), (10.0, False, "0"), (20.0, False, "1"), (30.0, True, "0")]
    for edges, high in (edges, False), (step["edges"], True):
        figure = Figure()
        axes = figure.add_subplot()
        _plot._Pins([{**step, "edges": edges}], (0.0, 100.0))(axes)
        (line,) = axes.lines
        levels = set(zip(line.get_xdata(), line.get_ydata()))
        assert axes.collections[0].get_paths()
        assert {at for at, y in levels if y == 0.66} == ({20.0, 30.0} if high else set())


@pytest.mark.parametrize("title", ["x", "word " * 10, "word " * 40, "x" * 300, "a\nb", ""])
def test_a_title_is_beside_nothing(title):
    bench, x = moved()
    x.line().faults(drop={"count": 1, "direction": "reply"})
    for frame in read(1, 0x14, 2), write(1, 0x0B, 5), write(1, 0x15, 9_000)[:-1] + b"\0":
        x.ask(frame)
    figure = bench.plot(title=title)
    figure.canvas.draw()
    (legend,) = [legend.get_window_extent() for legend in figure.legends]
    words = [text.get_window_extent() for text in figure.texts]
    top = max(axes.get_window_extent().y1 for axes in figure.axes)
    assert legend.y0 > top and legend.y1 <= figure.bbox.height and legend.x0 > 0
    assert not any(legend.overlaps(box) for box in words if box.width > 1)
    assert all(0 <= box.x0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height for box in words)
    shown = "".join(text.get_text() for text in figure.texts)
    assert "".join(title.split()) in "".join(shown.split())


def test_headings_of_drives_without_tracks_are_outside_of_the_axes():
    bench = Bench()
    x = bench.add("md3", name="x", fast_boot=True)
    bench.add("qsb-d", name="q")
    bench.add("qsb-d", name="r")
    bench.advance(1.0)
    x.registers["MotionControl"] = 1
    bench.advance(1.0)
    for drives in ("x", "q", "r"), ("q", "r"):
        figure = bench.plot(*drives, start=1.0)
        figure.canvas.draw()
        nothing = [text for text in figure.texts if text.get_text().endswith(": nothing happened")]
        assert len(nothing) == 2
        boxes = [text.get_window_extent() for text in figure.texts]
        boxes += [axes.get_tightbbox() for axes in figure.axes]
        assert all(box.y0 >= 0 for box in boxes)
        names = [text for text in figure.texts if text.get_text() in "qr"]
        for name in names:
            box = name.get_window_extent()
            assert not any(box.overlaps(axes.get_tightbbox()) for axes in figure.axes)
        assert not any(a.overlaps(b) for place, a in enumerate(boxes) for b in boxes[:place])


def test_a_plot_without_matplotlib_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(Error, match=r"^a plot needs matplotlib: pip install 'drivetwin\[plot\]'$"):
        Bench().plot()


def test_a_bench_with_ports_has_a_history():
    with drivetwin.run("md3", time="manual", fast_boot=True) as bench:
        assert bench["md3"].ask(write(1, 0x11, 1)) == write(1, 0x11, 1)
        bench.advance(3.0)
        assert bench.history("md3")[-1].tolist() == (bench.now, 10_000, 0.0)
        assert "write MotionControl = 1" in texts(bench.plot())
