//! A board in memory, on virtual time, with a drive of any kind and a cable to the test. The loop, the bus, the axis and the
//! station are those of the boards; the clock, the UART, the pins and the flash are simulated. A board belongs to its
//! thread.

mod hardware;

use std::collections::VecDeque;

use drivetwin_board::CablePort;
use drivetwin_board::station::{Station, TRACE};
use drivetwin_control::{Call, Decoder, Events, FRAME, Message, Reply, Request, encode};
use drivetwin_firmware::device::{Boot, Device, Duration, Instant, Line, Pin, Spec};
use drivetwin_firmware::shell::{BoardEvent, NoNetwork, TX_REPLIES};
use drivetwin_sim::catalog;

use hardware::{ENDS, Flash, InMemory};

/// The loop of the board.
type Loop = Station<'static, InMemory, &'static mut dyn Device, Flash, NoNetwork, TX_REPLIES, { ENDS.len() }>;

/// A drive on a board, and the computer at the other end of its cable.
pub struct Rig {
    station: Loop,
    spec: &'static Spec,
    /// Bytes that the computer has read from the port of control since the last message.
    partial: Vec<u8>,
    /// Messages that the computer has read.
    messages: VecDeque<Message<'static>>,
    number: u16,
}

impl Rig {
    /// A board with a drive of this kind, and a new memory. The drive has power, and the computer has both ports open with
    /// the settings of the drive's line.
    ///
    /// # Panics
    /// If there is no such kind.
    #[must_use]
    pub fn new(kind: &str, fast: bool) -> Self {
        Self::with(kind, Boot { fast, ..Boot::default() }, None)
    }

    /// A board whose memory has this content.
    ///
    /// # Panics
    /// If there is no such kind.
    #[must_use]
    pub fn with(kind: &str, boot: Boot, memory: Option<Vec<u8>>) -> Self {
        hardware::reset();
        let device: &'static mut dyn Device = Box::leak(catalog::make(kind).expect("a known kind"));
        let spec = device.spec();
        let mut memory = memory.unwrap_or_default();
        memory.resize(usize::from(spec.memory), 0xFF);
        let (device, ring) = (Box::leak(Box::new(device)), Box::leak(Box::new([0; TRACE])));
        let mut station: Loop = Station::new(device, &ENDS, Flash(memory), None, boot, ring);
        station.start();
        let mut rig = Self { station, spec, partial: Vec::new(), messages: VecDeque::new(), number: 0 };
        rig.set_line(spec.ports.first().and_then(|port| port.line));
        rig.open(CablePort::Control, true);
        rig.open(CablePort::Bus, true);
        rig.run_for(Duration::TICK);
        rig
    }

    /// Description of the drive.
    #[must_use]
    pub fn spec(&self) -> &'static Spec {
        self.spec
    }

    /// The present time.
    #[must_use]
    pub fn now(&self) -> Instant {
        hardware::now()
    }

    /// Runs the board until `until`, and reads the messages of the board.
    pub fn run_until(&mut self, until: Instant) {
        hardware::set_watched(true);
        self.run(until, Self::read_messages);
        hardware::set_watched(false);
    }

    /// Runs the board until `until`.
    pub fn run_raw(&mut self, until: Instant) {
        self.run(until, |_| {});
    }

    fn run(&mut self, until: Instant, read: impl Fn(&mut Self)) {
        hardware::set_horizon(until);
        // Two turns at the end: what the first one does may be work for the second one.
        let mut last = 2;
        while last > 0 {
            last -= u32::from(hardware::now() >= until);
            self.station.turn();
            read(self);
        }
    }

    fn read_messages(&mut self) {
        if hardware::unread(CablePort::Control) == 0 {
            return;
        }
        let mut bytes = std::mem::take(&mut self.partial);
        bytes.extend(hardware::read(CablePort::Control));
        while let Some(end) = bytes.iter().position(|byte| *byte == 0) {
            let frame: Vec<u8> = bytes.drain(..=end).collect();
            // A message borrows from its decoder.
            let decoder: &'static mut Decoder = Box::leak(Box::new(Decoder::new()));
            let (last, first) = frame.split_last().expect("it has its zero byte");
            for byte in first {
                decoder.push::<Message<'_>>(*byte);
            }
            self.messages.extend(decoder.push::<Message<'_>>(*last));
        }
        self.partial = bytes;
    }

    /// Runs the board for a time.
    pub fn run_for(&mut self, time: Duration) {
        self.run_until(self.now() + time);
    }

    /// Opens or closes a port of the computer. What a program has read of a frame is lost with it.
    pub fn open(&mut self, port: CablePort, open: bool) {
        if port == CablePort::Control {
            self.partial.clear();
        }
        hardware::open(port, open);
    }

    /// Sets the line settings of the computer's port of the bus.
    pub fn set_line(&mut self, line: Option<Line>) {
        hardware::set_host_line(line);
    }

    /// Settings of the UART.
    #[must_use]
    pub fn uart_line(&self) -> Option<Line> {
        hardware::uart_line()
    }

    /// Sends bytes to a port of the board.
    pub fn write(&mut self, port: CablePort, bytes: &[u8]) {
        hardware::write(port, bytes);
    }

    /// Bytes that the board has sent to the port of the bus since the last call.
    pub fn read_bus(&mut self) -> Vec<u8> {
        hardware::read(CablePort::Bus)
    }

    /// Bytes that the board has sent to a port since the last call.
    pub fn read_raw(&mut self, port: CablePort) -> Vec<u8> {
        hardware::read(port)
    }

    /// Makes the computer take only one packet at each read of a port.
    pub fn take_slowly(&mut self, port: CablePort) {
        hardware::take_slowly(port);
    }

    /// Number of bytes that the board has not taken from a port.
    #[must_use]
    pub fn untaken(&self, port: CablePort) -> usize {
        hardware::untaken(port)
    }

    /// Number of bytes that wait until the computer reads them.
    #[must_use]
    pub fn unread(&self, port: CablePort) -> usize {
        hardware::unread(port)
    }

    /// Makes the computer stop reading the port of control, or read it again.
    pub fn stall(&mut self, stalled: bool) {
        hardware::stall(stalled);
    }

    /// An event of the hardware now: an edge at a pin, a character at the UART.
    pub fn catch(&mut self, event: BoardEvent) {
        hardware::catch(event);
    }

    /// Sends a request, and returns its number.
    pub fn send(&mut self, call: Call<'_>) -> u16 {
        self.number = self.number.wrapping_add(1);
        let mut frame = [0; FRAME];
        let request = Request { number: self.number, call };
        let frame = encode(&request, &mut frame).expect("a short request");
        self.write(CablePort::Control, frame);
        self.number
    }

    /// Sends a request and waits for its reply. Events that come before it are kept.
    ///
    /// # Panics
    /// If there is no reply within a second, or one of another number.
    pub fn reply(&mut self, call: Call<'_>) -> Reply<'static> {
        let number = self.send(call);
        let until = self.now() + Duration::secs(1);
        loop {
            let is_reply = |message: &Message<'_>| matches!(message, Message::Reply(_));
            if let Some(place) = self.messages.iter().position(is_reply)
                && let Some(Message::Reply(reply)) = self.messages.remove(place)
            {
                assert_eq!(reply.number, number);
                return reply;
            }
            assert!(self.now() < until, "no reply to {call:?}");
            self.run_for(Duration::micros(1));
        }
    }

    /// Sends a request and waits for its answer.
    ///
    /// # Errors
    /// The board's refusal.
    ///
    /// # Panics
    /// The same as of [`reply`](Self::reply).
    pub fn call(
        &mut self,
        call: Call<'_>,
    ) -> Result<drivetwin_control::Answer<'static>, drivetwin_control::Refused> {
        self.reply(call).answer
    }

    /// Messages with events that have arrived since the last call.
    pub fn events(&mut self) -> Vec<Events<'static>> {
        let messages = std::mem::take(&mut self.messages);
        let events = messages.into_iter().filter_map(|message| match message {
            Message::Events(events) => Some(events),
            Message::Reply(_) => None,
        });
        events.collect()
    }

    /// All messages that have arrived since the last call.
    pub fn messages(&mut self) -> Vec<Message<'static>> {
        std::mem::take(&mut self.messages).into()
    }

    /// Characters that have left the UART, each with the start of its start bit.
    #[must_use]
    pub fn sent(&self) -> Vec<(Instant, u8)> {
        hardware::sent()
    }

    /// Steps that the axis has made: their times.
    #[must_use]
    pub fn steps(&self) -> Vec<Instant> {
        hardware::steps()
    }

    /// Changes of the output pins: time, pin, and the level, or `None` for a released pin.
    #[must_use]
    pub fn levels(&self) -> Vec<(Instant, Pin, Option<bool>)> {
        hardware::levels()
    }
}
