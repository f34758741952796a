//! A web server of a few lines that can be slow, cut connections, send garbage, and lie about lengths.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::AtomicBool;

use super::*;

/// What the server does to requests whose path holds `of`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trouble {
    None,
    /// Reads the request and says nothing until the client goes.
    Silent,
    /// Sends half of the body and closes.
    Cut,
    /// Sends bytes that are no HTTP.
    Garbage,
    /// Announces the largest length that there is, sends what it has, and closes.
    LengthTooLarge,
    /// Announces half of the length, and sends all.
    LengthTooSmall,
    /// Announces no length.
    NoLength,
    /// Sends as much as the client takes.
    Endless,
    /// Flips a bit in the middle of the body.
    WrongBytes,
    /// Sends another page with status 200, as a captive portal does.
    LoginPage,
    /// Answers with this status.
    Status(u16),
    /// Closes without a word.
    Closes,
    /// One byte at a time, slowly enough to miss every limit.
    Drip,
    /// Sends the client elsewhere, for ever.
    Redirects,
}

struct Shelf {
    files: Mutex<BTreeMap<String, Vec<u8>>>,
    trouble: Mutex<(Trouble, &'static str)>,
    requests: AtomicUsize,
    /// After so many requests the server is dead.
    dies_after: AtomicUsize,
    over: AtomicBool,
}

struct Server {
    url: String,
    shelf: Arc<Shelf>,
}

impl Server {
    fn start() -> Server {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let shelf = Arc::new(Shelf {
            files: Mutex::default(),
            trouble: Mutex::new((Trouble::None, "")),
            requests: AtomicUsize::new(0),
            dies_after: AtomicUsize::new(usize::MAX),
            over: AtomicBool::new(false),
        });
        let shared = shelf.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                if shared.over.load(Ordering::Relaxed) {
                    return;
                }
                let shared = shared.clone();
                std::thread::spawn(move || drop(shared.serve(stream)));
            }
        });
        Server { url: format!("http://127.0.0.1:{port}/cache"), shelf }
    }

    /// A server that CI has filled from the toy project.
    fn filled() -> Server {
        let server = Server::start();
        let (_, (report, remote)) = machine(server.options(RemoteMode::Write));
        assert!(report.warnings.is_empty(), "{report:#?}");
        assert_eq!((remote.sent, remote.failures), (4, 0), "{remote:?}");
        server
    }

    fn options(&self, mode: RemoteMode) -> RemoteOptions {
        hasty(RemoteOptions { mode, ..RemoteOptions::new(&self.url) })
    }

    fn trouble(&self, trouble: Trouble, of: &'static str) {
        *self.shelf.trouble.lock().unwrap() = (trouble, of);
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shelf.over.store(true, Ordering::Relaxed);
        // Wakes the listener, so that its thread ends.
        let _ = TcpStream::connect(self.url.trim_start_matches("http://").trim_end_matches("/cache"));
    }
}

impl Shelf {
    fn serve(&self, stream: TcpStream) -> std::io::Result<()> {
        let mut reader = BufReader::new(stream.try_clone()?);
        let mut out = stream;
        loop {
            let mut line = String::new();
            if reader.read_line(&mut line)? == 0 {
                return Ok(());
            }
            let mut words = line.split_whitespace().map(str::to_owned);
            let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
            let mut length = 0;
            loop {
                let mut header = String::new();
                reader.read_line(&mut header)?;
                if header.trim().is_empty() {
                    break;
                }
                if let Some(value) = header.to_lowercase().strip_prefix("content-length:") {
                    length = value.trim().parse().unwrap_or(0);
                }
            }
            let mut body = vec![0; length];
            reader.read_exact(&mut body)?;
            if self.requests.fetch_add(1, Ordering::Relaxed) >= self.dies_after.load(Ordering::Relaxed) {
                return Ok(());
            }
            if !self.answer(&method, &path, body, &mut out)? {
                return Ok(());
            }
        }
    }

    /// Answers one request; whether the connection stays.
    fn answer(&self, method: &str, path: &str, body: Vec<u8>, out: &mut TcpStream) -> std::io::Result<bool> {
        let (trouble, of) = *self.trouble.lock().unwrap();
        let trouble = if path.contains(of) { trouble } else { Trouble::None };
        let reply = |out: &mut TcpStream, status: u16, length: u64, body: &[u8]| {
            write!(out, "HTTP/1.1 {status} x\r\nContent-Length: {length}\r\n\r\n")?;
            out.write_all(body)
        };
        let found = self.files.lock().unwrap().get(path).cloned();
        match (trouble, method, found) {
            (Trouble::Status(status), ..) => reply(out, status, 4, b"none")?,
            (Trouble::Closes, ..) => return Ok(false),
            (Trouble::Silent, ..) => {
                let _ = out.read(&mut [0]);
                return Ok(false);
            }
            (Trouble::Garbage, ..) => {
                out.write_all(&[0xfe; 4000])?;
                return Ok(false);
            }
            (Trouble::LoginPage, ..) => reply(out, 200, 20, b"<html>log in</html>\n")?,
            (Trouble::Redirects, ..) => {
                write!(out, "HTTP/1.1 302 x\r\nLocation: {path}x\r\nContent-Length: 0\r\n\r\n")?;
            }
            (Trouble::Endless, ..) => {
                write!(out, "HTTP/1.1 200 x\r\nContent-Length: {}\r\n\r\n", 10_u64 << 20)?;
                while out.write_all(&[7; 65536]).is_ok() {}
                return Ok(false);
            }
            (_, "PUT", _) => {
                self.files.lock().unwrap().insert(path.to_owned(), body);
                reply(out, 201, 0, b"")?;
            }
            (_, _, None) => reply(out, 404, 0, b"")?,
            (_, "HEAD", Some(found)) => reply(out, 200, found.len() as u64, b"")?,
            (Trouble::Cut, _, Some(found)) => {
                reply(out, 200, found.len() as u64, &found[..found.len() / 2])?;
                return Ok(false);
            }
            (Trouble::LengthTooLarge, _, Some(found)) => {
                reply(out, 200, u64::MAX / 2, &found)?;
                return Ok(false);
            }
            (Trouble::LengthTooSmall, _, Some(found)) => {
                reply(out, 200, found.len() as u64 / 2, &found)?;
                return Ok(false);
            }
            (Trouble::NoLength, _, Some(found)) => {
                write!(out, "HTTP/1.1 200 x\r\nConnection: close\r\n\r\n")?;
                out.write_all(&found)?;
                return Ok(false);
            }
            (Trouble::Drip, _, Some(found)) => {
                write!(out, "HTTP/1.1 200 x\r\nContent-Length: {}\r\n\r\n", found.len())?;
                // The first byte, and then nothing until the client goes.
                out.write_all(&found[..1])?;
                let _ = out.read(&mut [0]);
                return Ok(false);
            }
            (Trouble::WrongBytes, _, Some(mut found)) => {
                let at = found.len() / 2;
                found[at] ^= 1;
                reply(out, 200, found.len() as u64, &found)?;
            }
            (Trouble::None, _, Some(found)) => reply(out, 200, found.len() as u64, &found)?,
        }
        Ok(true)
    }
}

#[test]
fn a_second_machine_takes_everything_over_http() {
    let server = Server::filled();
    let (toy, (report, remote)) = machine(server.options(RemoteMode::Read));
    assert!(toy.ran().is_empty() && report.warnings.is_empty(), "{report:#?}");
    assert_eq!((remote.hits, remote.failures), (4, 0));
    let before = server.shelf.files.lock().unwrap().clone();
    machine(server.options(RemoteMode::Write));
    assert_eq!(*server.shelf.files.lock().unwrap(), before, "what is there is not sent again");
}

#[test]
fn no_trouble_of_a_server_spoils_a_build_and_none_lasts() {
    let troubles = [
        Trouble::Silent,
        Trouble::Cut,
        Trouble::Garbage,
        Trouble::LengthTooLarge,
        Trouble::LengthTooSmall,
        Trouble::NoLength,
        Trouble::Endless,
        Trouble::WrongBytes,
        Trouble::LoginPage,
        Trouble::Status(500),
        Trouble::Status(503),
        Trouble::Status(403),
        Trouble::Status(401),
        Trouble::Status(418),
        Trouble::Status(304),
        Trouble::Status(204),
        Trouble::Closes,
        Trouble::Drip,
        Trouble::Redirects,
    ];
    let server = Server::filled();
    for trouble in troubles {
        for of in ["", "actions", "blobs", "lists"] {
            server.trouble(trouble, of);
            server.shelf.requests.store(0, Ordering::Relaxed);
            // `machine` looks at the outputs.
            let (toy, (report, remote)) = machine(server.options(RemoteMode::Read));
            let ran = toy.ran();
            assert!(!ran.is_empty(), "{trouble:?} of `{of}`: {remote:?}");
            assert!(remote.failures > 0, "{trouble:?} of `{of}`: {remote:?}");
            assert_eq!(report.warnings.len(), 1, "{trouble:?} of `{of}`: {report:#?}");
            assert!(cache_is_whole(&toy), "{trouble:?} of `{of}`");
            let requests = server.shelf.requests.load(Ordering::Relaxed);
            assert!(requests <= 60, "{trouble:?} of `{of}`: {requests} requests");
        }
    }
    server.trouble(Trouble::None, "");
    assert!(machine(server.options(RemoteMode::Read)).0.ran().is_empty());
}

#[test]
fn no_trouble_of_a_server_spoils_a_build_that_writes() {
    for trouble in [Trouble::Silent, Trouble::Closes, Trouble::Status(500), Trouble::Status(403), Trouble::Garbage] {
        let server = Server::start();
        server.trouble(trouble, "blobs");
        let options = RemoteOptions { upload_limit: Duration::from_secs(3), ..server.options(RemoteMode::Write) };
        let (_, (report, remote)) = machine(options);
        assert!(remote.sent == 0 && report.warnings.len() == 1, "{trouble:?}: {report:#?}");
        let records = server.shelf.files.lock().unwrap().keys().filter(|key| key.contains("actions")).count();
        assert_eq!(records, 0, "{trouble:?}: a record is sent after its blobs");
    }
}

#[test]
fn a_server_that_dies_half_way_costs_what_was_left() {
    let server = Server::filled();
    let mut counts = Vec::new();
    for alive in 0..30 {
        server.shelf.requests.store(0, Ordering::Relaxed);
        server.shelf.dies_after.store(alive, Ordering::Relaxed);
        let (toy, (report, _)) = machine(server.options(RemoteMode::Read));
        assert!(report.warnings.len() <= 1, "{report:#?}");
        counts.push(toy.ran().len());
    }
    assert!(counts[0] == 4 && counts.ends_with(&[0]), "{counts:?}");
}

#[test]
fn a_server_that_is_not_there_is_one_warning() {
    // A port that was free a moment ago.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    for url in [format!("http://127.0.0.1:{port}/cache"), format!("https://127.0.0.1:{port}/cache")] {
        let (toy, (report, remote)) = machine(hasty(RemoteOptions::new(url)));
        assert_eq!(toy.ran().len(), 4);
        assert!(remote.left_alone && report.warnings.len() == 1, "{report:#?}");
        assert!(report.warnings[0].contains("the build went on locally"), "{report:#?}");
    }
}
