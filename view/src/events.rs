//! Server-sent events, read from pieces of a stream.

/// Maximum length of one event in bytes: a whole state of 1,000 drives has less than 1 MB.
pub(crate) const LONGEST: usize = 64 << 20;

/// A reader of server-sent events.
pub(crate) struct Events {
    /// Maximum length of an event in bytes.
    longest: usize,
    /// The line that has not ended.
    line: Vec<u8>,
    /// True after a CR, of whose line end an LF may be a part.
    is_after_cr: bool,
    name: String,
    data: Option<Vec<u8>>,
}

/// An event.
#[derive(PartialEq, Eq, Debug)]
pub(crate) struct Event {
    /// Name; `message` if the stream gives none.
    pub(crate) name: String,
    /// The lines of its data.
    pub(crate) data: Vec<u8>,
}

impl Events {
    /// A reader at the beginning of a stream, whose events are at most so long, in bytes.
    pub(crate) fn new(longest: usize) -> Self {
        Self { longest, line: Vec::new(), is_after_cr: false, name: String::new(), data: None }
    }

    /// Takes a piece of the stream, and returns the events that it completes.
    ///
    /// # Errors
    /// An event is longer than the view takes.
    pub(crate) fn push(&mut self, piece: &[u8]) -> Result<Vec<Event>, String> {
        let mut events = Vec::new();
        for &byte in piece {
            let is_second = self.is_after_cr && byte == b'\n';
            self.is_after_cr = byte == b'\r';
            match byte {
                b'\n' if is_second => {}
                b'\r' | b'\n' => events.extend(self.end_line()),
                _ => self.line.push(byte),
            }
            if self.line.len() + self.data.as_ref().map_or(0, Vec::len) > self.longest {
                return Err("the server sent an event without end".to_owned());
            }
        }
        Ok(events)
    }

    /// Ends a line. Returns the event that an empty line completes.
    fn end_line(&mut self) -> Option<Event> {
        let line = std::mem::take(&mut self.line);
        if line.is_empty() {
            let name = std::mem::take(&mut self.name);
            let name = if name.is_empty() { "message".to_owned() } else { name };
            return self.data.take().map(|data| Event { name, data });
        }
        let colon = line.iter().position(|&byte| byte == b':').unwrap_or(line.len());
        let (field, rest) = line.split_at(colon);
        let value = rest.get(1..).unwrap_or_default();
        let value = value.strip_prefix(b" ").unwrap_or(value);
        match field {
            b"event" => self.name = String::from_utf8_lossy(value).into_owned(),
            b"data" => match &mut self.data {
                Some(data) => {
                    data.push(b'\n');
                    data.extend_from_slice(value);
                }
                None => self.data = Some(value.to_vec()),
            },
            // Numbers and times of reconnection have no meaning here, and an empty field is a comment.
            _ => {}
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(name: &str, data: &str) -> Event {
        Event { name: name.into(), data: data.into() }
    }

    #[test]
    fn events_in_whatever_pieces() {
        let stream = "event: update\ndata: {\"a\":1}\n\n: comment\n\nevent: update\r\ndata:x\r\ndata: y\r\n\r\nid: 7\rdata\r\rdata: ä\n\nevent: half\ndata: ne";
        let expected = [
            event("update", "{\"a\":1}"),
            event("update", "x\ny"),
            event("message", ""),
            event("message", "ä"),
        ];
        for size in 1..stream.len() {
            let mut events = Events::new(100);
            let pieces = stream.as_bytes().chunks(size);
            let got: Vec<Event> = pieces.flat_map(|piece| events.push(piece).unwrap()).collect();
            assert_eq!(got, expected, "pieces of {size}");
        }
    }

    #[test]
    fn an_endless_event_is_refused() {
        let refused = Err("the server sent an event without end".to_owned());
        let mut events = Events::new(10);
        assert_eq!(events.push(b"data: 123456"), refused);
        let mut events = Events::new(10);
        assert_eq!(events.push(b"data: 123\ndata: 4\n"), Ok(Vec::new()));
        assert_eq!(events.push(b"data: 5"), refused);
    }
}
