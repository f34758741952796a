//! Servers for tests of shared caches: an S3 that works, a way to it that dies half-way, and web servers in every kind of trouble.

use std::io::{self, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

/// moto's S3 (`pip install moto[server]`) with the bucket `kiln`; ends when it is dropped.
pub struct Moto {
    child: Child,
    port: u16,
}

impl Drop for Moto {
    fn drop(&mut self) {
        // One that has ended already is what is wanted.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Moto {
    /// A server that answers; `None` where none can be started.
    pub fn start() -> Option<Moto> {
        let port = TcpListener::bind("127.0.0.1:0").ok()?.local_addr().ok()?.port();
        let mut command = Command::new("moto_server");
        command.args(["-H", "127.0.0.1", "-p", &port.to_string()]).stdout(Stdio::null()).stderr(Stdio::null());
        let mut moto = Moto { child: command.spawn().ok()?, port };
        let bucket = "PUT /kiln HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 0\r\nConnection: close\r\n\r\n";
        loop {
            if moto.child.try_wait().ok()?.is_some() {
                return None;
            }
            let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)) else {
                thread::park_timeout(Duration::from_millis(20));
                continue;
            };
            let mut answer = String::new();
            stream.write_all(bucket.as_bytes()).ok()?;
            stream.read_to_string(&mut answer).ok()?;
            return answer.contains("200").then_some(moto);
        }
    }

    /// Where it listens, on this machine.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// A port that leads to this server until so many bytes came back through it; then both are dead.
    ///
    /// # Errors
    /// No port can be had.
    pub fn dying_after(self, bytes: usize) -> io::Result<u16> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port();
        let behind = self.port;
        let (tell, dead) = mpsc::channel();
        let left = Arc::new(AtomicUsize::new(bytes));
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let Ok(upstream) = TcpStream::connect(("127.0.0.1", behind)) else { return };
                let (Ok(mut asks), Ok(mut asked)) = (client.try_clone(), upstream.try_clone()) else { return };
                thread::spawn(move || io::copy(&mut asks, &mut asked));
                let (left, tell) = (left.clone(), tell.clone());
                thread::spawn(move || hand_back(upstream, client, &left, &tell));
            }
        });
        thread::spawn(move || {
            let _ = dead.recv();
            drop(self);
        });
        Ok(port)
    }
}

/// Copies until there is nothing left that may be.
fn hand_back(mut from: TcpStream, mut to: TcpStream, left: &AtomicUsize, tell: &mpsc::Sender<()>) {
    let mut part = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut part) {
        let enough = left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(count)).is_err();
        if enough {
            left.store(0, Ordering::Relaxed);
            let _ = tell.send(());
        }
        if enough || to.write_all(&part[..count]).is_err() {
            break;
        }
    }
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}

/// What a server may do to a request, with its name.
pub type Trouble = (&'static str, fn(&mut TcpStream));

/// Kinds of trouble; "slow" says after 700 ms that there is nothing.
pub const TROUBLES: [Trouble; 8] = [
    ("silent", |_| ()),
    ("slow", |stream| {
        // Nobody writes meanwhile: this waits.
        let _ = stream.set_read_timeout(Some(Duration::from_millis(700)));
        let _ = stream.peek(&mut [0]);
        let _ = stream.set_read_timeout(None);
        say(stream, "HTTP/1.1 404 x\r\nContent-Length: 0\r\n\r\n");
    }),
    ("garbage", |stream| say(stream, &"\u{1}\u{2}".repeat(3000))),
    ("wrong bytes", |stream| say(stream, "HTTP/1.1 200 x\r\nContent-Length: 9\r\n\r\n<html></x")),
    ("cut off", |stream| {
        say(stream, "HTTP/1.1 200 x\r\nContent-Length: 100000\r\n\r\nkiln");
        hang_up(stream);
    }),
    ("status 500", |stream| say(stream, "HTTP/1.1 500 x\r\nContent-Length: 0\r\n\r\n")),
    ("status 403", |stream| say(stream, "HTTP/1.1 403 x\r\nContent-Length: 0\r\n\r\n")),
    ("hangs up", hang_up),
];

fn say(stream: &mut TcpStream, text: &str) {
    // A client that went away hears nothing.
    let _ = stream.write_all(text.as_bytes());
}

fn hang_up(stream: &mut TcpStream) {
    let _ = stream.shutdown(Shutdown::Both);
}

/// The address of a web server that answers every request so; its listener ends with the process.
///
/// # Errors
/// No port can be had.
pub fn troublesome(trouble: fn(&mut TcpStream)) -> io::Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let port = listener.local_addr()?.port();
    thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            thread::spawn(move || {
                let mut request = [0; 4096];
                while let Ok(1..) = stream.read(&mut request) {
                    trouble(&mut stream);
                }
            });
        }
    });
    Ok(format!("http://127.0.0.1:{port}/cache"))
}
