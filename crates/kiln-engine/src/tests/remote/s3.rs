//! S3 against moto's server, where that is installed (`pip install moto[server]`).

use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use super::*;

/// Ends the server with the test.
struct Moto(Child, u16);

impl Drop for Moto {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Moto {
    /// A server with the bucket `kiln`; `None` where there is none to start.
    fn start() -> Option<Moto> {
        let port = std::net::TcpListener::bind("127.0.0.1:0").ok()?.local_addr().ok()?.port();
        let child = Command::new("moto_server")
            .args(["-H", "127.0.0.1", "-p", &port.to_string()])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .ok()?;
        let mut moto = Moto(child, port);
        let bucket =
            format!("PUT /kiln HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n");
        loop {
            if moto.0.try_wait().ok()?.is_some() {
                return None;
            }
            let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)) else {
                std::thread::park_timeout(Duration::from_millis(20));
                continue;
            };
            let mut answer = String::new();
            std::io::Write::write_all(&mut stream, bucket.as_bytes()).ok()?;
            std::io::Read::read_to_string(&mut stream, &mut answer).ok()?;
            return answer.contains("200").then_some(moto);
        }
    }

    fn options(&self, mode: RemoteMode) -> RemoteOptions {
        let setting = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        RemoteOptions {
            mode,
            settings: vec![
                setting("endpoint", &format!("http://127.0.0.1:{}", self.1)),
                setting("allow_http", "true"),
                setting("region", "us-east-1"),
                setting("access_key_id", "kiln"),
                setting("secret_access_key", "kiln"),
            ],
            ..RemoteOptions::new("s3://kiln/studio/cache")
        }
    }
}

#[test]
fn a_second_machine_takes_everything_from_s3() {
    let Some(moto) = Moto::start() else {
        assert!(std::env::var_os("KILN_REQUIRE_S3").is_none(), "moto_server is asked for and does not start");
        eprintln!("skipped: no moto_server here");
        return;
    };
    let (_, (report, remote)) = machine(moto.options(RemoteMode::Write));
    assert!(report.warnings.is_empty() && remote.sent == 4, "{report:#?} {remote:?}");
    let (toy, (report, remote)) = machine(moto.options(RemoteMode::Read));
    assert!(toy.ran().is_empty() && report.warnings.is_empty() && remote.hits == 4, "{report:#?} {remote:?}");
    // Another writer on an empty machine takes, and does not replace.
    let (toy, (_, remote)) = machine(moto.options(RemoteMode::Write));
    assert!(toy.ran().is_empty() && remote.sent == 0);
    // A bucket that is not there.
    let absent = RemoteOptions { url: "s3://absent/x".into(), ..moto.options(RemoteMode::Write) };
    let (toy, (report, _)) = machine(absent);
    assert_eq!((toy.ran().len(), report.warnings.len()), (4, 1), "{report:#?}");
    // The server is gone.
    let options = moto.options(RemoteMode::Read);
    drop(moto);
    let (toy, (report, _)) = machine(options);
    assert_eq!((toy.ran().len(), report.warnings.len()), (4, 1), "{report:#?}");
}
