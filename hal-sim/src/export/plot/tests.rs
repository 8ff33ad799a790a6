//! Pictures of traces.

use drivetwin_protocol::modbus::rtu;
use drivetwin_protocol::time::Span as _;

use super::*;
use drivetwin_firmware::device::Port;

use crate::bench::{Bench, Settings, Setup};
use crate::catalog;
use crate::record::trace::Retention;

fn make(kind: &str) -> Option<Box<dyn drivetwin_firmware::device::Device>> {
    catalog::make(kind).ok()
}

/// The trace of MD3s that move 10,000 steps from 2.5 s on, each after `times` reads of its speed.
fn moves(names: &[&str], times: usize) -> Trace {
    let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
    let drives: Vec<_> = names.iter().map(|name| bench.add::<drivetwin_firmware::md3::Md3>(name)).collect();
    bench.run_until(2_500.millis());
    for drive in &drives {
        for _ in 0..times {
            bench.ask(*drive, &rtu::read(1, 0x15, 1));
        }
        bench.ask(*drive, &rtu::write(1, 0x11, 1));
        bench.ask(*drive, &rtu::write(1, 0x0b, 5));
    }
    bench.run_until(bench.now() + 4.secs());
    Trace::parse(&bench.trace().to_text(), &make).unwrap()
}

fn draw(trace: &Trace, options: &Options) -> String {
    svg(trace, &make, options).unwrap()
}

/// Checks that the elements of a document are nested and closed. Returns the text of all elements.
fn parsed(picture: &str) -> String {
    let (mut open, mut texts) = (Vec::new(), String::new());
    for part in picture.split('<').skip(1) {
        let (tag, text) = part.split_once('>').expect("a tag ends");
        let name = tag.trim_start_matches('/').split_whitespace().next().unwrap().trim_end_matches('/');
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "the innermost element is closed");
        } else if !tag.ends_with('/') {
            open.push(name);
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        texts += text;
    }
    assert!(open.is_empty(), "{open:?}");
    texts
}

/// The points of a track.
fn points(picture: &str, track: &str) -> Vec<(f64, f64)> {
    let (_, group) = picture.split_once(&format!("data-track=\"{track}\"")).unwrap();
    let (_, path) = group.split_once("<path ").unwrap();
    let (_, path) = path.split_once(" d=\"").unwrap();
    let (path, _) = path.split_once('"').unwrap();
    let point = |point: &str| {
        let (x, y) = point.split_once(',').unwrap();
        (x.parse().unwrap(), y.parse().unwrap())
    };
    path.split(['M', 'L']).skip(1).map(point).collect()
}

#[test]
fn the_position_goes_through_its_points() {
    let trace = moves(&["x"], 0);
    let picture = draw(&trace, &Options { from: Some(2.0), to: Some(6.0), ..Options::default() });
    let text = parsed(&picture);
    for words in ["position", "speed", "steps/s", "10,000", "time in s", "STEP", "J3.7", "2.5", "MD3"] {
        assert!(text.contains(words), "{words}");
    }
    let position = points(&picture, "position");
    let (left, right) = (position[0], *position.last().unwrap());
    // The move takes 2.5 s: after 1.25 s it is at 5,000, in the middle. It begins after a request of
    // 8 characters, 3.5 of silence and one more at 9600 baud: 12.5 · 1.146 ms after 2.5 s.
    let begin = 2.5 + 12.5 * 11.0 / 9_600.0;
    let x = |seconds: f64| left.0 + (right.0 - left.0) * (seconds - 2.0) / 4.0;
    // The place of the line between two points.
    let near = |seconds: f64| {
        let x = x(seconds);
        let pair = position.windows(2).find(|pair| pair[0].0 <= x && x <= pair[1].0).unwrap();
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        (x, y0 + (y1 - y0) * (x - x0) / (x1 - x0).max(0.001))
    };
    let part = |point: (f64, f64)| (left.1 - point.1) / (left.1 - right.1);
    assert!((part(near(begin + 1.25)) - 0.5).abs() < 0.005, "{}", part(near(begin + 1.25)));
    // After the ramp of 0.5 s it has made 1,250 steps.
    assert!((part(near(begin + 0.5)) - 0.125).abs() < 0.005, "{}", part(near(begin + 0.5)));
    assert!(part(near(2.4)).abs() < 0.002 && (part(near(begin + 2.51)) - 1.0).abs() < 0.002);
}

#[test]
fn messages_have_their_words() {
    let picture = draw(&moves(&["x"], 1), &Options { title: "a <b> & \"c\"".into(), ..Options::default() });
    let text = parsed(&picture);
    for words in [
        "read SpeedLow = 5000",
        "write MotionControl = 1",
        "write Reserved = 5 → refused: 0x000B Reserved is read only (02)",
        "x.rs485",
        "refused",
        "a &lt;b&gt; &amp; \"c\"",
    ] {
        assert!(text.contains(words), "{words}");
    }
}

/// The trace of two MD3s with the addresses 1 and 2 on a line, and of an MDrive.
fn shared_line() -> Trace {
    let mut bench = Bench::with(Settings { trace: Retention::All, ..Settings::default() });
    let setup = |address| Setup { presets: vec![(0, address)], ..Setup::default() };
    let md3 = |bench: &mut Bench, name, address| {
        bench.add_with(name, catalog::make("md3").unwrap(), setup(address)).unwrap()
    };
    let (x, y) = (md3(&mut bench, "x", 1), md3(&mut bench, "y", 2));
    let mdrive = bench.add_with("m", catalog::make("mdrive").unwrap(), Setup::default()).unwrap();
    bench.share("line1", &[(x, Port(0)), (y, Port(0))]);
    bench.ask(x, &rtu::write(1, 0x11, 1));
    bench.run_until(3.secs());
    let mut broken = rtu::write(1, 0x15, 9_000);
    broken[7] ^= 1;
    for frame in [&broken[..], &rtu::read(2, 0x15, 1), &rtu::write(1, 0x0b, 5), &rtu::read(9, 0, 1)] {
        bench.ask(x, frame);
    }
    for (port, text) in [(0, &[0, 1, 0, 0, 0, 6, 1, 3, 0, 0x57, 0, 2][..]), (1, b"PR VM\r"), (1, b"\x05")] {
        let client = bench.connect_to(mdrive, Port(port)).unwrap();
        bench.send(client, text);
        bench.run_until(bench.now() + 100.millis());
        bench.disconnect(client);
    }
    bench.run_until(bench.now() + 1.secs());
    Trace::parse(&bench.trace().to_text(), &make).unwrap()
}

#[test]
fn messages_have_their_outcomes_and_signs() {
    let picture = draw(&shared_line(), &Options::default());
    parsed(&picture);
    // A message and its outcome are the title of its mark, with the time before them.
    let of = |lane: &str| {
        let (_, lane) = picture.split_once(&format!("data-messages=\"{lane}\"")).unwrap();
        let lane = lane.split("data-").next().unwrap();
        let titles = lane.split("<title>").skip(1).map(|title| {
            let (title, _) = title.split_once("</title>").unwrap();
            title.split_once(": ").unwrap().1.trim().to_owned()
        });
        let mut titles: Vec<String> = titles.collect();
        titles.dedup();
        titles
    };
    let corrupt = "8 bytes 01 06 00 15 23 28 81 21 → CRC wrong: 81 21 instead of 81 20";
    assert_eq!(
        of("x.rs485"),
        [
            "write MotionControl = 1 → starting for 2.5 s more",
            corrupt,
            "to 2: read SpeedLow",
            "write Reserved = 5 → refused: 0x000B Reserved is read only (02)",
            "read DeviceAddress → for address 9, nobody here (the drive has 1)",
        ]
    );
    // What x answers is no message to y, and what is for x has no outcome there.
    assert_eq!(
        of("y.rs485"),
        [
            "to 1: write MotionControl = 1",
            corrupt,
            "read SpeedLow = 5000",
            "to 1: write Reserved = 5",
            "read DeviceAddress → for address 9, nobody here (the drive has 2)",
        ]
    );
    assert_eq!(of("m.modbus"), ["read P = 0"]);
    let off = "accepted, without effect: this key is off: CE turns on Ctrl-C, ES selects Esc or Ctrl-E";
    assert_eq!(of("m.mcode"), ["PR VM → 768000".to_owned(), format!("Ctrl-E → {off}")]);
    // In the legend, and at each message.
    let signs = |class: &str| picture.matches(&format!("class=\"sign {class}\"")).count();
    let marks = ["refused", "without-effect", "not-received", "by-fault"];
    assert_eq!(marks.map(signs), [2, 2, 1 + 3 + 3 - 1, 0]);
}

#[test]
fn three_thousand_messages_make_no_bigger_picture() {
    let few = draw(&moves(&["x"], 100), &Options::default());
    let many = draw(&moves(&["x"], 3_000), &Options::default());
    parsed(&many);
    assert!(many.len() < 600_000 && few.len() < 600_000, "{} {}", few.len(), many.len());
    // A read that repeats is named once, and the move and the refusal among all the reads are named, too.
    let named = |words: &str| {
        let texts = many.split("<text class=\"words").skip(1);
        texts
            .filter(|text| text.split_once('>').is_some_and(|(_, text)| text.trim_start().starts_with(words)))
            .count()
    };
    assert_eq!(named("read SpeedLow = 5000"), 1);
    assert_eq!(named("write MotionControl = 1"), 1);
    assert_eq!(named("write Reserved = 5 → refused"), 1);
}

#[test]
fn drives_are_chosen_by_name() {
    let names: Vec<String> = (0..10).map(|n| format!("d{n}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let trace = moves(&names, 0);
    let all = draw(&trace, &Options::default());
    parsed(&all);
    assert_eq!(all.matches("data-drive=").count(), 10);
    let some = draw(&trace, &Options { drives: vec!["d7".into(), "d2".into()], ..Options::default() });
    assert_eq!(some.matches("data-drive=").count(), 2);
    let wrong = svg(&trace, &make, &Options { drives: vec!["d22".into()], ..Options::default() });
    assert!(wrong.as_ref().unwrap_err().starts_with("there is no drive 'd22'"), "{wrong:?}");
}

#[test]
fn a_time_axis_without_length_is_an_error() {
    let trace = moves(&["x"], 0);
    let error = |from, to| svg(&trace, &make, &Options { from, to, ..Options::default() }).unwrap_err();
    assert_eq!(error(Some(3.0), Some(2.0)), "the time axis begins at 3 s, so it cannot end at 2 s");
    let late = error(Some(100.0), None);
    assert!(
        late.starts_with("the trace ends at 6.5") && late.ends_with("there is nothing from 100 s on"),
        "{late}"
    );
    let empty = Trace::parse("drivetwin trace 1\ndrive x md3\n", &make).unwrap();
    parsed(&draw(&empty, &Options::default()));
}

#[test]
fn every_kind_of_drive_has_a_picture() {
    for kind in catalog::specs().map(|spec| spec.kind) {
        let text = format!("drivetwin trace 1\ndrive x {kind} fast\n2000 end\n");
        let trace = Trace::parse(&text, &make).unwrap();
        parsed(&draw(&trace, &Options::default()));
    }
}
