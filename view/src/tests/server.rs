//! The client against a small server: whatever a server sends, and when it is gone.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::Duration;

use hyper::Method;
use serde_json::{Value, json};

use crate::client::{Ask, Call, Client, Live, News};

/// Longest wait for something that must happen.
const LIMIT: Duration = Duration::from_secs(60);

/// Waits before the next try to connect.
const RETRIES: [Duration; 2] = [Duration::from_millis(1), Duration::from_millis(4)];

/// A server whose connections the test answers.
struct Server {
    listener: TcpListener,
    client: Client,
    news: Receiver<News>,
}

/// A connection with the request that it has sent.
struct Connection {
    stream: TcpStream,
    /// The lines of the head.
    head: Vec<String>,
    body: String,
}

impl Server {
    fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap()).parse().unwrap();
        let (sender, news) = sync_channel(1);
        let client = Client::start(address, sender, RETRIES).unwrap();
        Self { listener, client, news }
    }

    fn address(&self) -> String {
        format!("http://{}", self.listener.local_addr().unwrap())
    }

    fn follow(&self, number: u64, drive: Option<&str>) {
        self.client.ask(Ask::Follow { number, drive: drive.map(Into::into) });
    }

    fn call(&self, tag: u64, method: Method, path: &str, body: Option<Value>) {
        self.client.ask(Ask::Call(Call { method, path: path.into(), body, tag }));
    }

    fn accept(&self) -> Connection {
        let (mut stream, _) = self.listener.accept().unwrap();
        stream.set_read_timeout(Some(LIMIT)).unwrap();
        let mut bytes = Vec::new();
        let mut byte = [0];
        while !bytes.ends_with(b"\r\n\r\n") {
            assert_eq!(stream.read(&mut byte).unwrap(), 1, "the request has no end");
            bytes.push(byte[0]);
        }
        let head: Vec<String> = String::from_utf8(bytes).unwrap().lines().map(str::to_lowercase).collect();
        let length = head.iter().find_map(|line| line.strip_prefix("content-length: "));
        let mut body = vec![0; length.map_or(0, |length| length.parse().unwrap())];
        stream.read_exact(&mut body).unwrap();
        Connection { stream, head, body: String::from_utf8(body).unwrap() }
    }

    fn next(&self) -> News {
        self.news.recv_timeout(LIMIT).expect("news")
    }

    /// The next news of the stream with this number.
    fn live(&self, number: u64) -> Live {
        match self.next() {
            News::Live { number: of, live } if of == number => live,
            other => panic!("{other:?}"),
        }
    }

    #[track_caller]
    fn lost(&self, number: u64, why: &str) {
        let expected = format!("{} {why}", self.address());
        assert_eq!(self.live(number), Live::Lost(expected));
    }
}

impl Connection {
    fn send(&mut self, text: &str) {
        self.stream.write_all(text.as_bytes()).unwrap();
    }

    fn answer(mut self, status: &str, media: &str, body: &str) {
        let length = body.len();
        self.send(&format!(
            "HTTP/1.1 {status}\r\ncontent-type: {media}\r\ncontent-length: {length}\r\n\r\n{body}"
        ));
    }

    /// Begins a stream of events in chunks, as the control API does.
    fn open(&mut self) {
        self.send("HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\ntransfer-encoding: chunked\r\n\r\n");
    }

    fn chunk(&mut self, text: &str) {
        self.send(&format!("{:x}\r\n{text}\r\n", text.len()));
    }

    /// Waits for the end of the connection. Returns false if the client has sent something instead.
    fn wait_for_end(mut self) -> bool {
        self.stream.read(&mut [0]).map_or(true, |read| read == 0)
    }
}

#[test]
fn updates_in_pieces() {
    let server = Server::start();
    server.follow(1, Some("Lüfter 1"));
    let mut stream = server.accept();
    assert_eq!(stream.head[0], "get /api/live?drive=l%c3%bcfter%201 http/1.1");
    assert!(stream.head.contains(&format!("host: {}", &server.address()["http://".len()..])));
    stream.open();
    assert_eq!(server.live(1), Live::Open);
    stream.chunk(": a comment\n\nevent: other\ndata: {}\n\nevent: upd");
    stream.chunk("ate\ndata: {\"state\":");
    stream.chunk("{\"version\":\"ü\"}}\n\nevent: update\ndata: {}\n\n");
    assert_eq!(server.live(1), Live::Update(json!({"state": {"version": "ü"}})));
    assert_eq!(server.live(1), Live::Update(json!({})));
}

#[test]
fn a_stream_that_ends_in_an_event_is_lost_and_followed_again() {
    let server = Server::start();
    server.follow(1, None);
    for _ in 0..2 {
        let mut stream = server.accept();
        assert_eq!(stream.head[0], "get /api/live http/1.1");
        stream.open();
        stream.chunk("event: update\ndata: {\"state\":{}}\n\nevent: update\ndata: {\"st");
        assert_eq!(server.live(1), Live::Open);
        assert_eq!(server.live(1), Live::Update(json!({"state": {}})));
        drop(stream);
        server.lost(1, "has broken the connection");
    }
    let mut stream = server.accept();
    stream.open();
    stream.send("0\r\n\r\n");
    assert_eq!(server.live(1), Live::Open);
    server.lost(1, "has ended the connection");
}

#[test]
fn garbage_is_a_lost_connection() {
    let server = Server::start();
    server.follow(1, None);
    let mut stream = server.accept();
    stream.send("SSH-2.0-OpenSSH_9.6\r\n\r\n");
    server.lost(1, "does not speak HTTP");
    server.accept().answer("200 OK", "text/html", "<html>");
    server.lost(1, "is not the control address of a drivetwin");
    for data in ["{\"state\":", "[1]", "\u{1b}[2J", ""] {
        let mut stream = server.accept();
        stream.open();
        stream.chunk(&format!("event: update\ndata: {data}\n\n"));
        assert_eq!(server.live(1), Live::Open);
        server.lost(1, "sent an update that is not JSON");
        assert!(stream.wait_for_end());
    }
}

#[test]
fn a_refused_stream_says_why() {
    let server = Server::start();
    server.follow(1, Some("x"));
    // As the control API refuses a name in a query.
    let problem = "{\"status\":422,\"detail\":\"there is no drive 'x'\"}";
    server.accept().answer("422 Unprocessable Entity", "application/problem+json", problem);
    assert_eq!(server.live(1), Live::Gone("there is no drive 'x'".into()));
    // The client may have tried the first stream again, so the second one has a server of its own.
    let server = Server::start();
    server.follow(2, None);
    server.accept().answer(
        "503 Service Unavailable",
        "application/problem+json",
        "{\"detail\":\"16 readers\"}",
    );
    assert_eq!(server.live(2), Live::Lost("16 readers".into()));
    server.accept().answer("404 Not Found", "text/plain", "");
    assert_eq!(server.live(2), Live::Lost("the server answers 404 Not Found".into()));
}

#[test]
fn following_another_drive_closes_the_first_stream() {
    let server = Server::start();
    server.follow(1, Some("x"));
    let mut first = server.accept();
    first.open();
    assert_eq!(server.live(1), Live::Open);
    server.follow(2, Some("y"));
    assert!(first.wait_for_end());
    let mut second = server.accept();
    assert_eq!(second.head[0], "get /api/live?drive=y http/1.1");
    second.open();
    assert_eq!(server.live(2), Live::Open);
}

#[test]
fn no_server() {
    let server = Server::start();
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let (sender, news) = sync_channel(1);
    let client = Client::start(format!("127.0.0.1:{port}").parse().unwrap(), sender, RETRIES).unwrap();
    client.ask(Ask::Follow { number: 1, drive: None });
    let News::Live { live: Live::Lost(reason), .. } = news.recv_timeout(LIMIT).unwrap() else {
        panic!("not lost")
    };
    let expected = format!("http://127.0.0.1:{port} cannot be reached: ");
    assert!(reason.starts_with(&expected), "{reason}");
    drop(server);
}

#[test]
fn calls_and_their_answers() {
    let server = Server::start();
    server.call(7, Method::PUT, "/api/drives/x/pins/J2.3", Some(json!({"level": "low"})));
    server.call(8, Method::DELETE, "/api/drives/x/faults/stall", None);
    let connection = server.accept();
    assert_eq!(connection.head[0], "put /api/drives/x/pins/j2.3 http/1.1");
    assert!(connection.head.contains(&"content-type: application/json".to_owned()));
    assert_eq!(connection.body, "{\"level\":\"low\"}");
    connection.answer("204 No Content", "text/plain", "");
    assert_eq!(server.next(), News::Answer { tag: 7, result: Ok(()) });
    let connection = server.accept();
    assert_eq!(
        (connection.head[0].as_str(), connection.body.as_str()),
        ("delete /api/drives/x/faults/stall http/1.1", "")
    );
    // The guard of the control API demands it also without a body.
    assert!(connection.head.contains(&"content-type: application/json".to_owned()));
    connection.answer("409 Conflict", "application/problem+json", "{\"detail\":\"x has no power\"}");
    assert_eq!(server.next(), News::Answer { tag: 8, result: Err("x has no power".into()) });
    server.call(9, Method::PUT, "/api/time", Some(json!({"mode": "real"})));
    drop(server.accept());
    let broken = Err(format!("{} has broken the connection", server.address()));
    assert_eq!(server.next(), News::Answer { tag: 9, result: broken });
}

#[test]
fn an_advance_delays_no_other_call() {
    let server = Server::start();
    server.call(1, Method::POST, "/api/time/advance", Some(json!({"seconds": 86400})));
    let advance = server.accept();
    server.call(2, Method::PUT, "/api/time", Some(json!({"mode": "real"})));
    server.accept().answer("200 OK", "application/json", "{}");
    assert_eq!(server.next(), News::Answer { tag: 2, result: Ok(()) });
    advance.answer("200 OK", "application/json", "{}");
    assert_eq!(server.next(), News::Answer { tag: 1, result: Ok(()) });
}

#[test]
fn descriptions() {
    let server = Server::start();
    server.client.ask(Ask::Kind("md3".into()));
    let connection = server.accept();
    assert_eq!(connection.head[0], "get /api/kinds/md3 http/1.1");
    connection.answer("200 OK", "application/json", "{\"kind\":\"md3\"}");
    assert_eq!(server.next(), News::Kind { kind: "md3".into(), description: Some(json!({"kind": "md3"})) });
    server.client.ask(Ask::Kind("old".into()));
    server.accept().answer("404 Not Found", "text/plain", "");
    assert_eq!(server.next(), News::Kind { kind: "old".into(), description: None });
}

/// A server whose reader takes nothing must make its next update from the state of then, so the client may not read on
/// (HOST-26).
#[test]
fn a_slow_view_reads_nothing_more() {
    let server = Server::start();
    server.follow(1, None);
    let mut stream = server.accept();
    stream.open();
    assert_eq!(server.live(1), Live::Open);
    let mut writer = stream.stream.try_clone().unwrap();
    writer.set_nonblocking(true).unwrap();
    let update = format!("event: update\ndata: {{\"version\":\"{}\"}}\n\n", "x".repeat(60_000));
    let chunk = format!("{:x}\r\n{update}\r\n", update.len());
    // The sockets hold some megabytes, and then no more goes in.
    let (mut sent, mut refused) = (0_usize, 0);
    while refused < 100 {
        match writer.write(&chunk.as_bytes()[sent % chunk.len()..]) {
            Ok(more) => (sent, refused) = (sent + more, 0),
            Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                refused += 1;
                thread::park_timeout(Duration::from_millis(2));
            }
            Err(error) => panic!("{error}"),
        }
        assert!(sent < 256 << 20, "the client reads on");
    }
    assert!(matches!(server.live(1), Live::Update(_)));
}
