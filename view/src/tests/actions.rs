//! Calls, from keys.

use hyper::Method;
use ratatui::crossterm::event::KeyCode;
use serde_json::{Value, json};

use super::{View, bench, view};
use crate::app::{Effect, Mode};
use crate::client::{Ask, News};

/// The one call that the view has wanted since the last time: method, path, body. Its answer comes later.
#[track_caller]
fn call(view: &mut View) -> (Method, String, Option<Value>) {
    let wanted = view.wanted();
    match &wanted[..] {
        [Effect::Ask(Ask::Call(call))] => (call.method.clone(), call.path.clone(), call.body.clone()),
        other => panic!("not one call: {other:?}"),
    }
}

#[track_caller]
fn calls(keys: &str, method: Method, path: &str, body: Option<Value>) {
    let mut view = view();
    view.keys(keys);
    assert_eq!(call(&mut view), (method, path.into(), body), "{keys}");
}

#[test]
fn pins() {
    let level = |level: &str| Some(json!({ "level": level }));
    calls("3l", Method::PUT, "/api/drives/x/pins/J2.2", level("low"));
    calls("3h", Method::PUT, "/api/drives/x/pins/J2.2", level("high"));
    calls("3jo", Method::PUT, "/api/drives/x/pins/J2.10", level("open"));
    // A pin that is pressed is low, and open again at the next press.
    calls("3 ", Method::PUT, "/api/drives/x/pins/J2.2", level("low"));
    calls("3j ", Method::PUT, "/api/drives/x/pins/J2.10", level("open"));
}

#[test]
fn faults() {
    calls("4j ", Method::PUT, "/api/drives/x/faults/over_current", None);
    let mut view = view();
    view.update(json!({"state": {"drive": {"faults": {"over_temperature": true}}}}));
    view.keys("4 ");
    assert_eq!(call(&mut view), (Method::DELETE, "/api/drives/x/faults/over_temperature".into(), None));
}

#[test]
fn power_and_time() {
    for (keys, action) in [("Po", "on"), ("Pf", "off"), ("Pc", "cycle"), ("Px", "cut")] {
        calls(keys, Method::POST, "/api/drives/x/power", Some(json!({ "action": action })));
    }
    calls("tr", Method::PUT, "/api/time", Some(json!({"mode": "real"})));
    calls("tm", Method::PUT, "/api/time", Some(json!({"mode": "manual"})));
    calls("n", Method::POST, "/api/time/advance", Some(json!({"to": "next"})));
    let mut view = view();
    view.keys("P");
    view.shows(80, 24, &["power of x", "cut in the next save"]);
    view.keys("z");
    assert!(view.wanted().is_empty() && view.app.mode == Mode::Panes);
    view.keys("tx10");
    view.press(KeyCode::Enter);
    assert_eq!(call(&mut view), (Method::PUT, "/api/time".into(), Some(json!({"mode": "x10"}))));
}

/// Types into an input line that keys open.
#[track_caller]
fn types(keys: &str, text: &str, method: Method, path: &str, body: Value) {
    let mut view = view();
    view.keys(keys);
    view.app.key(
        ratatui::crossterm::event::KeyEvent::new(
            KeyCode::Char('u'),
            ratatui::crossterm::event::KeyModifiers::CONTROL,
        ),
        view.now,
    );
    view.keys(text);
    view.press(KeyCode::Enter);
    assert_eq!(call(&mut view), (method, path.into(), Some(body)), "{keys} {text}");
}

#[test]
fn input_lines() {
    let (put, post) = (Method::PUT, Method::POST);
    types("2jje", "0x1F40", put.clone(), "/api/drives/x/registers/Speed", json!({"value": 8000}));
    types("2je", "-5", put.clone(), "/api/drives/x/registers/MoveSteps", json!({"value": -5}));
    types("2e", "1,2", put.clone(), "/api/drives/x/registers/MotionControl", json!({"value": [1, 2]}));
    types("3v", "2.5 V", put.clone(), "/api/drives/x/pins/J2.2", json!({"volts": 2.5}));
    types(
        "3ju",
        "1000 2000",
        post.clone(),
        "/api/drives/x/pins/J2.10/pulses",
        json!({"count": 1000, "hz": 2000.0}),
    );
    types("3w", "-400 10000", post.clone(), "/api/drives/x/encoder", json!({"counts": -400, "hz": 10000.0}));
    types("6f", "drop=0.5 mute=true", put, "/api/buses/rs485/faults", json!({"drop": 0.5, "mute": true}));
    types("a", "1.25", post.clone(), "/api/time/advance", json!({"seconds": 1.25}));
    types("ta", "1.25", post, "/api/time/advance", json!({"seconds": 1.25}));
}

#[test]
fn a_line_shows_the_faults_that_it_has() {
    let mut view = view();
    view.keys("6f");
    view.shows(80, 24, &["faults of rs485: drop=0.01"]);
}

#[test]
fn a_refused_edit_says_why_and_stays() {
    let mut view = view();
    view.keys("2jje");
    view.shows(80, 24, &["Speed = 8000", "a number: 8000, -5, 0x1F40"]);
    // The old value is marked, and typing replaces it, unless the cursor is moved.
    let marked = |view: &View| view.buffer(80, 24)[("Speed = ".len() as u16, 22)].modifier;
    assert!(marked(&view).contains(ratatui::style::Modifier::REVERSED));
    view.press(KeyCode::End);
    assert!(!marked(&view).contains(ratatui::style::Modifier::REVERSED));
    view.keys("x");
    view.press(KeyCode::Enter);
    assert!(view.wanted().is_empty());
    view.shows(80, 24, &["'8000x' is not a number; 8000, -5 and 0x1F40 are"]);
    view.press(KeyCode::Backspace);
    view.keys("0");
    view.press(KeyCode::Enter);
    let Some(Effect::Ask(Ask::Call(call))) = view.wanted().pop() else { panic!("no call") };
    view.shows(80, 24, &["waiting for the bench"]);
    let sentence = "Speed is 1 to 40000".to_owned();
    view.hear(News::Answer { tag: call.tag, result: Err(sentence.clone()) });
    view.shows(80, 24, &["Speed = 80000", &sentence]);
    assert_eq!(super::cell_of(&view.buffer(80, 24), &sentence).fg, ratatui::style::Color::Red);
    view.press(KeyCode::Backspace);
    assert!(!view.screen(80, 24).contains(&sentence));
    view.press(KeyCode::Enter);
    let Some(Effect::Ask(Ask::Call(call))) = view.wanted().pop() else { panic!("no call") };
    assert_eq!(call.body, Some(json!({"value": 8000})));
    view.hear(News::Answer { tag: call.tag, result: Ok(()) });
    assert_eq!(view.app.mode, Mode::Panes);
}

#[test]
fn typing_replaces_the_old_value_of_a_register() {
    let mut view = view();
    view.keys("2e7");
    view.press(KeyCode::Enter);
    let value = Some(json!({"value": 7}));
    assert_eq!(call(&mut view), (Method::PUT, "/api/drives/x/registers/MotionControl".into(), value));
}

#[test]
fn the_answer_of_an_earlier_call_does_not_end_an_edit() {
    let mut view = view();
    view.keys("3l2e");
    view.hear(News::Answer { tag: 1, result: Ok(()) });
    assert!(matches!(view.app.mode, Mode::Entry { .. }));
}

#[test]
fn a_refused_key_says_why_for_a_while() {
    let mut view = view();
    view.keys("3l");
    let Some(Effect::Ask(Ask::Call(call))) = view.wanted().pop() else { panic!("no call") };
    let sentence = "a train of pulses drives J2.2";
    view.hear(News::Answer { tag: call.tag, result: Err(sentence.into()) });
    view.shows(80, 24, &[sentence]);
    view.wait(10_000);
    assert!(!view.screen(80, 24).contains(sentence));
}

#[test]
fn what_a_bench_cannot_do_is_refused_with_its_reason() {
    let mut view = view();
    let reason = "a board has its own clock";
    let cannot = json!({"time": reason, "advance": reason, "faults": "a board has no line here"});
    view.update(json!({"state": {"cannot": cannot}}));
    for key in "tan".chars() {
        view.press(KeyCode::Char(key));
        view.shows(80, 24, &[reason]);
        view.press(KeyCode::Esc);
    }
    view.keys("6f");
    view.shows(80, 24, &["a board has no line here"]);
    assert!(view.wanted().is_empty() && view.app.mode == Mode::Panes);
}

#[test]
fn names_in_calls_are_escaped() {
    let mut state = bench();
    state["drives"] = json!({"Lüfter 1/α": {"index": 0, "kind": "md3", "powered": true}});
    state["drive"]["name"] = json!("Lüfter 1/α");
    let mut view = View::of(state.clone());
    view.whole(state);
    view.wanted();
    view.keys("3l");
    assert_eq!(call(&mut view).1, "/api/drives/L%C3%BCfter%201%2F%CE%B1/pins/J2.10");
}

#[test]
fn keys_act_only_on_a_drive_that_is_known() {
    let mut view = View::connecting();
    view.keys("3l4 Pf2e6f");
    view.press(KeyCode::Down);
    let wanted = format!("{:?}", view.wanted());
    assert!(!wanted.contains("Call"), "{wanted}");
}

/// The drive that the screen shows in the next moment may be another one.
#[test]
fn keys_wait_for_the_drive_that_was_chosen() {
    let mut view = view();
    view.keys("3]l");
    assert!(view.wanted().is_empty());
}

#[test]
fn pasted_text_is_no_key() {
    let mut view = view();
    view.app.paste("Pfq3l");
    assert!(view.app.mode == Mode::Panes);
    view.keys("2e");
    view.app.paste("5\n");
    view.shows(80, 24, &["MotionControl = 5"]);
}

#[test]
fn q_and_control_c_end() {
    let mut view = view();
    view.keys("q");
    assert_eq!(view.wanted(), [Effect::Quit]);
    view.keys("2e");
    view.keys("q");
    assert!(view.wanted().is_empty());
    let held = ratatui::crossterm::event::KeyModifiers::CONTROL;
    let key = ratatui::crossterm::event::KeyEvent::new(KeyCode::Char('c'), held);
    assert_eq!(view.app.key(key, view.now), [Effect::Quit]);
}

/// No keys in any order do harm.
#[test]
fn keys_in_any_order() {
    let codes: Vec<KeyCode> = crate::keys::TABLE
        .iter()
        .flat_map(|row| row.keys.iter().copied())
        .chain("01234567offcx1-".chars().map(KeyCode::Char))
        .chain([KeyCode::Backspace, KeyCode::Delete, KeyCode::Enter])
        .filter(|code| *code != KeyCode::Char('q'))
        .collect();
    let mut view = view();
    // A linear congruential generator (Knuth, MMIX).
    let mut random = 1_u64;
    for _ in 0..3_000 {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        view.press(codes[(random >> 33) as usize % codes.len()]);
        if random >> 60 == 0 {
            view.screen(80, 24);
            view.whole(bench());
        }
    }
    view.screen(140, 40);
}
