//! The terminal: taken at the start of the view, and given back at its end, also after a panic.

use std::io::{self, IsTerminal as _, Stdout, Write as _};
use std::panic;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::event::{DisableBracketedPaste, EnableBracketedPaste};
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::crossterm::{execute, queue};
use ratatui::layout::{Position, Rect};

/// True while the view has the terminal.
static IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// The terminal of the view. Dropping it gives it back.
pub(crate) struct Screen(Terminal<CrosstermBackend<Stdout>>);

impl Screen {
    /// Takes the terminal.
    ///
    /// # Errors
    /// One sentence: standard input or output is not a terminal, or cannot be used.
    pub(crate) fn take() -> Result<Self, String> {
        for (name, is_terminal) in
            [("standard output", io::stdout().is_terminal()), ("standard input", io::stdin().is_terminal())]
        {
            if !is_terminal {
                return Err(format!("the view needs a terminal, and {name} is not one"));
            }
        }
        restore_on_panic();
        let taken = || -> io::Result<Self> {
            enable_raw_mode()?;
            IS_TAKEN.store(true, Ordering::SeqCst);
            execute!(io::stdout(), EnterAlternateScreen, EnableBracketedPaste)?;
            let mut screen = Self(Terminal::new(CrosstermBackend::new(io::stdout()))?);
            screen.redraw()?;
            Ok(screen)
        };
        taken().map_err(|error| {
            restore();
            format!("the terminal cannot be used: {error}")
        })
    }

    /// Clears the screen, so that the next drawing is whole. Nothing is asked of the terminal: over a slow line the answer
    /// may come too late.
    pub(crate) fn redraw(&mut self) -> io::Result<()> {
        let size = self.0.size()?;
        self.0.resize(Rect::from((Position::ORIGIN, size)))
    }

    /// The terminal to draw on; `None` after a panic, which has given it back.
    pub(crate) fn get(&mut self) -> Option<&mut Terminal<CrosstermBackend<Stdout>>> {
        IS_TAKEN.load(Ordering::SeqCst).then_some(&mut self.0)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        restore();
    }
}

/// Gives the terminal back, once.
fn restore() {
    if IS_TAKEN.swap(false, Ordering::SeqCst) {
        let mut stdout = io::stdout();
        // A terminal that is gone needs nothing.
        let _ = queue!(stdout, DisableBracketedPaste, LeaveAlternateScreen, Show);
        let _ = stdout.flush();
        let _ = disable_raw_mode();
    }
}

/// Gives the terminal back before the message of a panic of any thread is printed.
fn restore_on_panic() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            restore();
            before(info);
        }));
    });
}

/// The clock of the view. All other code has the time as an argument.
pub(crate) struct Clock(Instant);

impl Clock {
    #[expect(clippy::disallowed_methods, reason = "the clock of the view, which shows real time")]
    pub(crate) fn start() -> Self {
        Self(Instant::now())
    }

    /// Time since the start.
    pub(crate) fn now(&self) -> Duration {
        self.0.elapsed()
    }
}
