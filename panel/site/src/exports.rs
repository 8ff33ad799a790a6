//! Functions that JavaScript calls. Arguments and results are bytes in the memory of the module.
//!
//! JavaScript asks for room with [`reserve`], writes an argument there, calls a function with its length, and reads
//! [`output`]. There is one site, and one thread.
#![allow(unsafe_code, reason = "`no_mangle` is an unsafe attribute; no two functions have the same name")]

use std::cell::RefCell;
use std::time::Duration;

use crate::Site;

#[derive(Default)]
struct State {
    site: Option<Site>,
    input: Vec<u8>,
    output: Vec<u8>,
}

thread_local! {
    static STATE: RefCell<State> = RefCell::default();
}

fn with<T>(act: impl FnOnce(&mut State) -> T) -> T {
    STATE.with_borrow_mut(act)
}

impl State {
    /// The argument: the first `length` bytes of the input.
    fn argument(&self, length: usize) -> &[u8] {
        self.input.get(..length).unwrap_or_default()
    }
}

/// Makes room for an argument of `length` bytes, and returns its address.
#[unsafe(no_mangle)]
pub extern "C" fn reserve(length: usize) -> *const u8 {
    with(|state| {
        state.input.resize(length, 0);
        state.input.as_ptr()
    })
}

/// Address of the output.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    with(|state| state.output.as_ptr())
}

/// Length of the output.
#[unsafe(no_mangle)]
pub extern "C" fn output_length() -> usize {
    with(|state| state.output.len())
}

/// Begins with the bench of a bench file. Returns 1; 0 if the file has an error, whose sentence is the output.
#[unsafe(no_mangle)]
pub extern "C" fn start(length: usize) -> u32 {
    with(|state| {
        let text = String::from_utf8_lossy(state.argument(length)).into_owned();
        match Site::new(&text) {
            Ok(site) => {
                state.site = Some(site);
                1
            }
            Err(sentence) => {
                state.output = sentence.into_bytes();
                0
            }
        }
    })
}

/// Lets time pass, in seconds.
#[unsafe(no_mangle)]
pub extern "C" fn pass(seconds: f64) {
    with(|state| {
        if let Some(site) = &mut state.site {
            site.pass(seconds);
        }
    });
}

/// Answers a call. Returns the status of HTTP; the output is the body.
#[unsafe(no_mangle)]
pub extern "C" fn call(length: usize) -> u32 {
    with(|state| {
        let call = state.argument(length).to_vec();
        let Some(site) = &mut state.site else { return 503 };
        let answer = site.call(&call);
        state.output = answer.body;
        answer.status.into()
    })
}

/// Begins to follow the bench; with the name of a drive, with its details.
#[unsafe(no_mangle)]
pub extern "C" fn follow(length: usize) {
    with(|state| {
        let name = String::from_utf8_lossy(state.argument(length)).into_owned();
        if let Some(site) = &mut state.site {
            site.follow((!name.is_empty()).then_some(name));
        }
    });
}

/// Returns 1 if something has changed since the last update; the output is the update. `milliseconds` is the time since
/// the last one.
#[unsafe(no_mangle)]
pub extern "C" fn update(milliseconds: f64) -> u32 {
    with(|state| {
        let since_last = Duration::from_secs_f64(milliseconds.clamp(0.0, 1e6) / 1e3);
        match state.site.as_mut().and_then(|site| site.update(since_last)) {
            Some(update) => {
                state.output = update;
                1
            }
            None => 0,
        }
    })
}
