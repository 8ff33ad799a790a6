//! Cells, from states typed by hand.

use std::time::Duration;

use ratatui::crossterm::event::KeyCode;
use ratatui::style::{Color, Modifier};
use serde_json::{Value, json};

use super::{View, bench, cell_of, frame, md3, text, view};
use crate::app::App;
use crate::client::{Ask, Live};

/// Half a minute of a move: up, and back again.
fn moved(view: &mut View) {
    for step in 0..=120 {
        let at = 83.25 + f64::from(step) / 4.0;
        let position = 12_345 + if step < 60 { step } else { 120 - step } * 1_000;
        let speed = if step < 60 { 4_000.0 } else { -4_000.0 };
        let drives = json!({"x": {"position": position, "speed": speed}});
        view.update(json!({"state": {"time": {"seconds": at}, "drives": drives}}));
    }
}

fn with_traffic(view: &mut View) {
    view.update(json!({"traffic": [
        frame(1, 80.5, "write Speed = 8000", "done", "done"),
        frame(2, 80.625, "write Speed = 90000", "refused", "refused: 0x0014 Speed is 1 to 40000 (03)"),
        frame(3, 83.0, "read Speed", "not listening", "not listening: starting for 1.2 s more"),
        {"number": 4, "at": 83.125, "drive": "x", "port": "rs485", "text": "position 12", "verdict": "done",
            "bytes": "00", "sent": true},
    ], "left_out": 1200}));
}

#[test]
fn a_small_screen() {
    let mut view = view();
    moved(&mut view);
    let screen = view.screen(80, 24);
    let lines: Vec<&str> = screen.lines().collect();
    let begin = [
        "drivetwin http://127.0.0.1:8080  real time 1:53.250                       ● live",
        "┌ 0 drives 3 ──────┐x  power on  US Digital MD3 stepper drive, 7 A",
        "│▶ x         md3   │○ D5  ● D6",
        "│○ Lüfter    mdrob…│▶ moving  position 12,345  speed −4,000/s  current 1.00 A  …",
        "│! 東京      qsb-d │rs485 9600 8E1: 1,234 executed, 2 refused",
        "│                  │1 plot 2 registers 3 pins 4 faults 5 traffic 6 bench",
        "│                  │┏ 1 plot 10 s ━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━━┓",
        "│                  │┃━ position 12,345                                         ┃",
    ];
    assert_eq!(lines[..8], begin);
    assert_eq!(lines.len(), 24);
    view.shows(80, 24, &["53,345│⠉", "12,345│", "−10 s", "now┃", "━ speed −4,000/s", "0│", "−4,000│⣀⣀"]);
}

#[test]
fn a_large_screen_has_everything_at_once() {
    let mut view = view();
    moved(&mut view);
    with_traffic(&mut view);
    view.shows(
        140,
        40,
        &[
            "1 plot 10 s",
            "2 registers 3",
            "3 pins",
            "4 faults",
            "5 traffic 4, 1,200 left out",
            "motor m 7.50 rev, 188 rpm",
            "MoveSteps     -10000 R/W Steps of a move.",
            "J2.10 ▁ low  input or outp",
            "[ ] over_current",
            "1:20.625   +125 ms → write Speed = 90000",
        ],
    );
    view.keys("6");
    view.shows(
        140,
        40,
        &["6 bench", "rs485", "! drop=0.01", "motor of x: m 7.50 rev", "wire x.J3.7 ► 東京.DIO0"],
    );
}

#[test]
fn lights_levels_and_causes_have_colours_and_signs() {
    let mut view = view();
    view.update(json!({"state": {"drive": {"leds": {"D5": true}, "faults": {"over_current": true}}}}));
    let buffer = view.buffer(140, 40);
    assert_eq!(cell_of(&buffer, "● D5").fg, Color::Red);
    assert_eq!(cell_of(&buffer, "● D6").fg, Color::Green);
    assert_eq!(cell_of(&buffer, "! over_current").fg, Color::Red);
    assert_eq!(cell_of(&buffer, "[!] over_current").fg, Color::Red);
    assert_eq!(cell_of(&buffer, "▔ high").fg, Color::Green);
    assert_eq!(cell_of(&buffer, "power on").fg, Color::Green);
    view.update(json!({"state": {"drives": {"x": {"powered": false}}}}));
    assert_eq!(cell_of(&view.buffer(140, 40), "power off").fg, Color::Red);
}

#[test]
fn ports_count_in_the_words_of_the_page() {
    let mut view = view();
    view.update(
        json!({"state": {"drive": {"ports": {"rs485": {"requests": 1, "refused": 0, "dropped": 1200}}}}}),
    );
    view.shows(80, 24, &["rs485 9600 8E1: 1 executed, 1,200 ignored"]);
}

#[test]
fn the_list_counts_messages_that_failed() {
    let mut view = view();
    view.update(
        json!({"state": {"drives": {"x": {"refused": 3, "unanswered": 9}, "東京": {"unanswered": 1}}}}),
    );
    let screen = view.screen(80, 24);
    let lines: Vec<&str> = screen.lines().collect();
    assert!(lines[2].starts_with("│▶ x") && lines[2].contains(" 12│○ D5"), "{screen}");
    assert!(lines[4].starts_with("│! 東京") && lines[4].contains(" 1│rs485"), "{screen}");
}

/// The terminal decides what is behind the text, so no colour may need a dark or a light one.
#[test]
fn only_colours_that_every_terminal_and_background_shows() {
    let mut view = view();
    moved(&mut view);
    with_traffic(&mut view);
    let shown = [Color::Reset, Color::Red, Color::Green, Color::Cyan, Color::Magenta];
    for keys in ["1", "2", "3", "4", "5", "6", "?", "P"] {
        view.keys(keys);
        for size in [(80, 24), (140, 40)] {
            let buffer = view.buffer(size.0, size.1);
            for cell in &buffer.content {
                assert!(shown.contains(&cell.fg) && cell.bg == Color::Reset, "{cell:?}");
            }
            let plain = view.buffer_in(size.0, size.1, false);
            assert!(plain.content.iter().all(|cell| (cell.fg, cell.bg) == (Color::Reset, Color::Reset)));
            assert_eq!(text(&plain), text(&buffer));
        }
        view.press(KeyCode::Esc);
    }
}

#[test]
fn traffic_in_words_with_colours_of_verdicts() {
    let mut view = view();
    with_traffic(&mut view);
    view.keys("5");
    view.shows(80, 24, &["1:20.500 → write Speed = 8000  done", "← position 12", "refused: 0x0014 Speed …"]);
    let buffer = view.buffer(140, 40);
    assert_eq!(cell_of(&buffer, "done").fg, Color::Green);
    assert_eq!(cell_of(&buffer, "refused: 0x0014").fg, Color::Red);
    assert!(cell_of(&buffer, "not listening:").modifier.contains(Modifier::DIM));
    // The newest message that was not done is whole, and so is a chosen one.
    view.shows(80, 24, &["read Speed: not listening: starting for 1.2 s more"]);
    view.press(KeyCode::Up);
    view.press(KeyCode::Up);
    view.shows(
        80,
        24,
        &[
            "1:20.625 rs485 010600141F40C1C6  answer 010600141F40C1C6",
            "write Speed = 90000: refused: 0x0014 Speed is 1 to 40000",
        ],
    );
    view.press(KeyCode::Esc);
    view.keys("!");
    let screen = view.screen(80, 24);
    assert!(!screen.contains("write Speed = 8000") && screen.contains("read Speed"), "{screen}");
    view.keys("!/READ");
    view.shows(80, 24, &["5 traffic 1", "/READ", "read Speed", "search in traffic: READ"]);
    view.press(KeyCode::Esc);
    view.shows(80, 24, &["write Speed = 8000"]);
}

#[test]
fn registers_in_the_order_of_the_manual_with_meaning() {
    let mut view = view();
    view.keys("2");
    let screen = view.screen(80, 24);
    let place = |name: &str| screen.find(name).unwrap();
    assert!(
        place("MotionControl ") < place("MoveSteps ") && place("MoveSteps ") < place("Speed "),
        "{screen}"
    );
    view.shows(80, 24, &["MotionControl  §7.15  0x0011  R/W  0 to 65535  default 0", "Move = 1 (begin)"]);
    view.keys("x");
    view.shows(80, 24, &["0xFFFFD8F0 R/W", "0x00001F40 R/W"]);
    view.keys("/steps");
    let screen = view.screen(80, 24);
    assert!(!screen.contains("MotionControl"), "{screen}");
    view.shows(80, 24, &["2 registers 2 /steps", "Speed     0x00001F40 R/W Greatest speed in steps/s."]);
    // Without a description the names and values are there.
    let mut bare = View::of(bench());
    bare.whole(bench());
    bare.keys("2");
    bare.shows(80, 24, &["MotionControl", "8000"]);
}

#[test]
fn a_changed_register_is_lit_for_a_moment() {
    let mut view = view();
    view.keys("2");
    assert_eq!(cell_of(&view.buffer(80, 24), "MoveSteps ").fg, Color::Reset);
    view.update(json!({"state": {"drive": {"registers": {"MoveSteps": 5}}}}));
    assert_eq!(cell_of(&view.buffer(80, 24), "MoveSteps ").fg, Color::Magenta);
    assert_eq!(cell_of(&view.buffer(80, 24), "Speed ").fg, Color::Reset);
    let dark = view.app.wake(view.now).expect("it ends by itself");
    view.wait(dark.as_millis() as u64);
    assert_eq!(cell_of(&view.buffer(80, 24), "MoveSteps ").fg, Color::Reset);
    assert_eq!(view.app.wake(view.now), Some(Duration::from_secs(3)), "the end of a silence");
}

#[test]
fn the_plot_pauses_scrolls_and_zooms() {
    let mut view = view();
    moved(&mut view);
    view.keys("1-");
    view.shows(80, 24, &["1 plot 30 s", "72,345│", "12,345│", "−30 s"]);
    view.keys("++p");
    view.shows(80, 24, &["1 plot 5 s, paused at 1:53.250", "1:48.250", "1:53.250┃"]);
    view.update(json!({"state": {"time": {"seconds": 200.0}, "drives": {"x": {"position": 0}}}}));
    view.shows(80, 24, &["paused at 1:53.250"]);
    view.press(KeyCode::Left);
    view.shows(80, 24, &["paused at 1:52.750", "━ position 14,345"]);
    view.keys("p");
    view.shows(80, 24, &["1 plot 5 s ━", "━ position 0 "]);
    for _ in 0..99 {
        view.keys("+");
        view.press(KeyCode::Left);
    }
    view.shows(80, 24, &["1 plot 1 s"]);
    (0..99).for_each(|_| view.keys("-"));
    view.shows(80, 24, &["1 plot 600 s"]);
}

#[test]
fn ten_minutes_of_motion_are_kept() {
    let mut view = view();
    for step in 0..30_000 {
        let drives = json!({"x": {"position": step, "speed": 1.0}});
        let at = 100.0 + f64::from(step) / 30.0;
        view.update(json!({"state": {"time": {"seconds": at}, "drives": drives}}));
    }
    let motion = view.app.bench.motion("x").unwrap();
    let (first, last) = (motion.front().unwrap(), motion.back().unwrap());
    assert!((599.0..=600.0).contains(&(last.at - first.at)) && motion.len() <= 18_000, "{first:?} {last:?}");
    view.keys("-----");
    view.shows(80, 24, &["600 s", "29,999│"]);
}

#[test]
fn a_drive_without_motion_or_lights() {
    let mut view = view();
    view.press(KeyCode::Char(']'));
    view.press(KeyCode::Char(']'));
    view.wait(150);
    view.shows(80, 24, &["東京  power on", "no motion", "! fault", "this drive has no motion"]);
}

#[test]
fn a_bench_of_one_drive_has_no_list() {
    let mut state = bench();
    state["drives"] = json!({"x": {"index": 0, "kind": "md3", "powered": true, "position": 0, "speed": 0}});
    let mut view = View::of(state.clone());
    view.whole(state);
    assert!(!view.screen(80, 24).contains("drives"));
    view.keys("0");
    view.shows(80, 24, &["┏ 1 plot"]);
}

fn thousand() -> Value {
    let drives = (0..1_000).map(|n| {
        let drive = json!({"index": n, "kind": if n % 2 == 0 { "md3" } else { "mdrobot" }, "powered": true});
        (format!("axis{n}"), drive)
    });
    json!({"time": {"mode": "real", "seconds": 1.0}, "drives": drives.collect::<serde_json::Map<_, _>>()})
}

#[test]
fn a_thousand_drives() {
    let mut view = View::of(thousand());
    view.wanted();
    view.shows(80, 24, &["0 drives 1000", "axis0 ", "axis17 "]);
    view.keys("0");
    view.press(KeyCode::End);
    view.shows(80, 24, &["axis999", "axis981"]);
    view.keys("/AXIS77");
    view.shows(80, 24, &["11/1000", "axis77 ", "axis770", "axis779"]);
    view.press(KeyCode::Enter);
    assert_eq!(view.app.drive(), Some("axis77"));
    view.press(KeyCode::Down);
    view.press(KeyCode::Down);
    // Only the drive at which a walk ends is followed.
    view.wait(149);
    assert!(view.wanted().is_empty());
    view.wait(1);
    let wanted = view.wanted();
    let ask = format!("{wanted:?}");
    assert!(wanted.len() == 1 && ask.contains("Follow") && ask.contains("\"axis771\""), "{ask}");
    view.press(KeyCode::Esc);
    view.shows(80, 24, &["0 drives 1000", "axis771"]);
}

#[test]
fn sizes() {
    let mut view = view();
    moved(&mut view);
    with_traffic(&mut view);
    for pane in "0123456".chars() {
        view.press(KeyCode::Char(pane));
        for (width, height) in
            [(0, 0), (1, 1), (39, 30), (40, 12), (41, 13), (80, 24), (110, 32), (109, 32), (400, 100)]
        {
            let screen = view.screen(width, height);
            let is_small = width < 40 || height < 12;
            assert_eq!(screen.contains("drivetwin http"), !is_small, "{width} x {height}\n{screen}");
        }
    }
    view.shows(39, 9, &["the terminal is too small: 40 x 12 is", "the least"]);
}

#[test]
fn a_lost_connection_shows_and_comes_back() {
    let mut view = view();
    let reason = "http://127.0.0.1:8080 has ended the connection";
    view.live(Live::Lost(reason.into()));
    view.shows(80, 24, &["✗ connection lost", reason, "▶ x"]);
    assert_eq!(cell_of(&view.buffer(80, 24), "✗ connection").fg, Color::Red);
    let mut state = bench();
    state["time"]["seconds"] = json!(90.0);
    view.whole(state);
    view.shows(80, 24, &["● live", "1:30.000"]);
    assert!(!view.screen(80, 24).contains("ended the connection"));
}

#[test]
fn a_server_that_hangs_is_not_live() {
    let mut view = view();
    view.wait(2_999);
    view.shows(80, 24, &["● live"]);
    for (second, words) in [(3, "✗ no answer for 3 s"), (4, "✗ no answer for 4 s")] {
        // The view draws itself anew at this time.
        view.now = view.app.wake(view.now).expect("a silence");
        assert_eq!(view.now, Duration::from_secs(second));
        view.shows(80, 24, &[words, "▶ x"]);
    }
    assert_eq!(cell_of(&view.buffer(80, 24), "✗ no answer").fg, Color::Red);
    view.update(json!({"state": {"time": {"seconds": 90.0}}}));
    view.shows(80, 24, &["● live"]);
    // In manual time nothing happens, and nothing is said.
    view.update(json!({"state": {"time": {"mode": "manual"}}}));
    assert_eq!(view.app.wake(view.now), None);
    view.wait(10_000);
    view.shows(80, 24, &["● live"]);
}

#[test]
fn the_same_message_from_two_streams_is_shown_once() {
    let mut view = view();
    with_traffic(&mut view);
    view.whole(bench());
    with_traffic(&mut view);
    assert_eq!(view.app.frames().len(), 4);
}

#[test]
fn another_run_begins_anew() {
    let mut view = view();
    moved(&mut view);
    with_traffic(&mut view);
    let mut state = bench();
    state["time"]["seconds"] = json!(0.5);
    view.whole(state);
    assert_eq!((view.app.frames().len(), view.app.bench.motion("x").unwrap().len()), (0, 1));
}

#[test]
fn a_drive_that_is_gone_is_left_for_the_first() {
    let mut view = view();
    view.live(Live::Gone("there is no drive 'x'".into()));
    assert!(matches!(&view.wanted()[..], [crate::app::Effect::Ask(Ask::Follow { drive: None, .. })]));
    view.whole(
        json!({"time": {"mode": "real", "seconds": 1.0}, "drives": {"y": {"index": 0, "kind": "md3"}}}),
    );
    let wanted = format!("{:?}", view.wanted());
    assert!(wanted.contains("Follow") && wanted.contains("\"y\""), "{wanted}");
    view.shows(80, 24, &["● live", "y    US Digital", "there is no drive x; the view shows y"]);
}

#[test]
fn the_drive_of_the_address_is_followed_at_first() {
    let of = |address| {
        let mut view = View::connecting_to(address);
        view.whole(bench());
        let wanted = format!("{:?}", view.wanted());
        assert!(wanted.contains(&format!("drive: {:?}", view.app.drive())), "{wanted}");
        view
    };
    assert_eq!(of("127.0.0.1:8080/#/%E6%9D%B1%E4%BA%AC").app.drive(), Some("東京"));
    let other = of("127.0.0.1:8080/#/y");
    assert_eq!(other.app.drive(), Some("x"));
    other.shows(80, 24, &["there is no drive y; the view shows x"]);
}

#[test]
fn news_of_an_earlier_stream_mean_nothing() {
    let mut view = view();
    let number = view.number - 1;
    view.hear(crate::client::News::Live { number, live: Live::Update(json!({"state": {"drives": null}})) });
    assert_eq!(view.app.bench.names().len(), 3);
}

#[test]
fn before_the_first_update() {
    let mut view = View::connecting();
    view.shows(80, 24, &["○ connecting", "connecting to http://127.0.0.1:8080"]);
    view.live(Live::Lost("http://127.0.0.1:8080 cannot be reached: Connection refused".into()));
    view.shows(80, 24, &["cannot be reached: Connection refused; the view tries", "again until you press q"]);
}

/// A server may send whatever is JSON.
#[test]
fn states_of_wrong_shapes() {
    let shapes = [
        json!(null),
        json!(7),
        json!("x"),
        json!([]),
        json!({}),
        json!({"drives": []}),
        json!({"drives": {"x": 5}, "drive": []}),
        json!({"drives": {"x": {"position": "far", "index": -1}}, "time": {"seconds": "late"}, "drive": {"name": "x", "registers": [1]}}),
        json!({"drives": {"x": {"kind": "md3", "position": 1e300, "speed": -1e300}}, "time": {"seconds": 1e300}}),
        json!({"drives": {"\u{1b}[2J": {"kind": "a\nb\u{0}"}}, "buses": {"b": 1}, "motors": 3, "wires": {"a": 1}}),
        json!({"drive": {"name": "x", "registers": {"Speed": {"a": 1}}, "pins": {"p": 3}, "leds": {"l": "on"},
            "faults": {"f": 0}, "ports": {"p": 1}, "motion": 5}, "drives": {"x": {"kind": "md3"}}}),
    ];
    for shape in shapes {
        let mut view = view();
        view.whole(shape.clone());
        view.update(json!({"traffic": [1, null, {}, {"at": "x"}], "left_out": -1}));
        view.update(json!({"state": shape, "traffic": {}}));
        for key in "0123456".chars() {
            view.press(KeyCode::Char(key));
            let buffer = view.buffer(140, 40);
            assert!(buffer.content.iter().all(|cell| !cell.symbol().contains(char::is_control)));
            view.screen(80, 24);
        }
    }
}

#[test]
fn a_description_of_a_wrong_shape() {
    for description in [json!(1), json!([]), json!({"registers": [1, {"name": 2}], "pins": {}, "faults": 1})]
    {
        let mut view = view();
        view.describe("md3", description);
        view.keys("2");
        view.shows(80, 24, &["MotionControl", "8000"]);
    }
}

#[test]
fn help_has_every_key() {
    let mut view = view();
    view.keys("?");
    let mut seen = view.screen(80, 24);
    for _ in 0..9 {
        view.press(KeyCode::PageDown);
        seen += &view.screen(80, 24);
    }
    (0..9).for_each(|_| view.press(KeyCode::PageUp));
    view.shows(80, 24, &["│everywhere"]);
    for row in crate::keys::TABLE {
        assert!(seen.contains(row.help), "{}\n{seen}", row.help);
    }
    view.keys("q");
    view.shows(80, 24, &["1 plot"]);
}

#[test]
fn the_log_of_a_run_is_a_pane() {
    let mut view = view();
    view.keys("7");
    assert!(!view.screen(80, 24).contains("7 log"));
    view.app = App::new(&"http://127.0.0.1:8080".parse().unwrap(), true);
    view.number = 0;
    let start = view.app.start();
    view.take(vec![start]);
    for line in 0..1_200 {
        view.app.add_log(format!("\u{1b}[31mline {line}"));
    }
    let mut state = bench();
    state["drives"] = json!({"x": {"index": 0, "kind": "md3"}});
    view.whole(state);
    view.describe("md3", md3());
    view.keys("7");
    view.shows(80, 24, &["7 log", "line 1199", "line 1187"]);
    view.press(KeyCode::Home);
    view.shows(80, 24, &["line 200"]);
    view.keys("/line 300");
    view.shows(80, 24, &["line 300"]);
    assert!(!view.screen(80, 24).contains("line 301"));
}
