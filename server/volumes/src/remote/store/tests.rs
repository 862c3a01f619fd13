//! Stores that misbehave: each response is written byte by byte.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::Mutex;
use std::time::Instant;

use object_store::memory::InMemory;
use object_store::{BackoffConfig, ObjectStoreExt, RetryConfig};

use super::*;

/// Short time limits.
fn limits() -> Limits {
    Limits {
        connect: Duration::from_secs(2),
        idle: Duration::from_millis(300),
        whole: Duration::from_millis(900),
        retry: RetryConfig {
            backoff: BackoffConfig {
                init_backoff: Duration::from_millis(1),
                max_backoff: Duration::from_millis(5),
                base: 2.0,
            },
            max_retries: 2,
            retry_timeout: Duration::from_secs(5),
        },
    }
}

/// Serves one request per connection. `answer` gets the request's lines and the number of earlier requests; a line `~` is a pause.
fn serve(answer: impl Fn(&[String], usize) -> String + Send + Sync + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = listener.local_addr().expect("an address");
    let answer = Arc::new(answer);
    std::thread::spawn(move || {
        for (number, connection) in listener.incoming().enumerate() {
            let (mut connection, answer) = (connection.expect("a connection"), Arc::clone(&answer));
            std::thread::spawn(move || {
                let lines = BufReader::new(connection.try_clone().expect("a handle")).lines();
                let lines = lines.map_while(Result::ok).take_while(|line| !line.is_empty());
                let text = answer(&lines.collect::<Vec<_>>(), number);
                for (at, part) in text.split('~').enumerate() {
                    if at > 0 {
                        std::thread::sleep(Duration::from_millis(200));
                    }
                    if connection.write_all(part.as_bytes()).is_err() {
                        break;
                    }
                }
            });
        }
    });
    format!("http://{address}")
}

fn ok(headers: &str, body: &str) -> String {
    format!("HTTP/1.1 200 OK\r\nConnection: close\r\n{headers}\r\n{body}")
}

fn status(line: &str) -> String {
    format!("HTTP/1.1 {line}\r\nConnection: close\r\nContent-Length: 6\r\n\r\nsecret")
}

fn open(address: &str) -> Remote {
    let (address, _) = Address::named(address).expect("an address");
    Remote::open(&address, limits()).expect("a store")
}

fn get(address: &str) -> Result<Vec<u8>, Fault> {
    let object = open(address).get("a", Part::Whole, 100, &|| false);
    object.map(|object| object.bytes)
}

fn why(result: Result<Vec<u8>, Fault>) -> String {
    match result {
        Err(Fault::Other(why)) => why,
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_object_and_its_parts_are_read() {
    let address = serve(|lines, _| {
        let range = lines
            .iter()
            .find_map(|line| line.to_lowercase().strip_prefix("range: bytes=").map(str::to_owned));
        let part = |range: &str, body: &str| {
            let length = body.len();
            format!(
                "HTTP/1.1 206 Partial Content\r\nConnection: close\r\nContent-Length: {length}\r\nContent-Range: bytes {range}/5\r\n\r\n{body}"
            )
        };
        match range.as_deref() {
            None => ok("Content-Length: 5\r\n", "hello"),
            Some("1-3") => part("1-3", "ell"),
            Some("-2") => part("3-4", "lo"),
            Some(other) => panic!("{other}"),
        }
    });
    let remote = open(&address);
    let get = |part, limit| {
        let object = remote.get("a", part, limit, &|| false);
        object.map(|object| (String::from_utf8(object.bytes).expect("text"), object.size))
    };
    assert_eq!(get(Part::Whole, 5), Ok(("hello".to_owned(), 5)));
    assert_eq!(get(Part::At(1..4), 5), Ok(("ell".to_owned(), 5)));
    assert_eq!(get(Part::End(2), 5), Ok(("lo".to_owned(), 5)));
    let error = Fault::Other("5 bytes, expected 4 at most".to_owned());
    assert_eq!(get(Part::Whole, 4), Err(error));
}

#[test]
fn what_may_pass_is_tried_again() {
    let address = serve(|_, number| match number {
        0 | 1 => status("500 Internal Server Error"),
        _ => ok("Content-Length: 2\r\n", "ok"),
    });
    assert_eq!(get(&address), Ok(b"ok".to_vec()));
    let count = Arc::new(Mutex::new(0));
    let seen = Arc::clone(&count);
    let address = serve(move |_, _| {
        *seen.lock().expect("a count") += 1;
        status("503 Service Unavailable")
    });
    let text = why(get(&address));
    assert!(
        text.contains("503 Service Unavailable") && !text.contains("secret"),
        "{text}"
    );
    assert_eq!(*count.lock().expect("a count"), 3);
}

#[test]
fn what_is_not_there_is_no_failure() {
    assert_eq!(get(&serve(|_, _| status("404 Not Found"))), Err(Fault::Missing));
    assert_eq!(get(&serve(|_, _| status("403 Forbidden"))), Err(Fault::Forbidden));
    let text = why(get(&serve(|_, _| status("401 Unauthorized"))));
    assert!(text.contains("401 Unauthorized"), "{text}");
}

#[test]
fn a_store_that_stalls_is_left() {
    let begin = Instant::now();
    let text = why(get(&serve(|_, _| format!("{}{}", "~".repeat(50), ok("", "")))));
    assert_eq!(text, "no answer in time");
    // In its body, before each byte but the last of them too late for the whole.
    let text = why(get(&serve(|_, _| ok("Content-Length: 50\r\n", &"x~".repeat(50)))));
    assert_eq!(text, "no answer in time");
    assert!(begin.elapsed() < Duration::from_secs(10));
    let silent = serve(|_, _| "~".repeat(50));
    let stop = || begin.elapsed() > Duration::from_millis(100);
    let stopped = open(&silent).get("a", Part::Whole, 100, &stop);
    assert_eq!(
        stopped.expect_err("it was stopped"),
        Fault::Other("reading was cancelled".to_owned())
    );
}

#[test]
fn redirects_elsewhere_are_refused() {
    let elsewhere = serve(|_, _| ok("Content-Length: 2\r\n", "no"));
    let to = elsewhere.clone();
    let address = serve(move |_, _| {
        format!("HTTP/1.1 302 Found\r\nConnection: close\r\nLocation: {to}/a?key=secret\r\nContent-Length: 0\r\n\r\n")
    });
    let text = why(get(&address));
    assert!(text.contains(&format!("redirected to {elsewhere}, expected")), "{text}");
    assert!(!text.contains("secret"), "{text}");
    let within = serve(|lines, _| match lines[0].as_str() {
        "GET /a HTTP/1.1" => {
            "HTTP/1.1 302 Found\r\nConnection: close\r\nLocation: /b\r\nContent-Length: 0\r\n\r\n".to_owned()
        }
        _ => ok("Content-Length: 2\r\n", "ok"),
    });
    assert_eq!(get(&within), Ok(b"ok".to_vec()));
    let round =
        serve(|_, _| "HTTP/1.1 302 Found\r\nConnection: close\r\nLocation: /a\r\nContent-Length: 0\r\n\r\n".to_owned());
    assert_eq!(why(get(&round)), "redirected more than 5 times");
}

#[test]
fn false_lengths_are_errors() {
    let short = why(get(&serve(|_, _| ok("Content-Length: 9\r\n", "short"))));
    assert!(
        short.contains("the connection ended") || short.contains("end of file"),
        "{short}"
    );
    let huge = why(get(&serve(|_, _| ok("Content-Length: 99999999999999\r\n", "short"))));
    assert_eq!(huge, "99999999999999 bytes, expected 100 at most");
    // What follows is no part of it.
    assert_eq!(
        get(&serve(|_, _| ok("Content-Length: 2\r\n", "longer"))),
        Ok(b"lo".to_vec())
    );
    let none = why(get(&serve(|_, _| ok("", "endless"))));
    assert!(none.contains("Content-Length"), "{none}");
}

#[test]
fn credentials_are_sent_and_not_told() {
    let address = serve(|lines, _| {
        let sent = lines[0] == "GET /x.zarr/a?key=secret HTTP/1.1"
            && lines
                .iter()
                .any(|line| line.eq_ignore_ascii_case("authorization: Basic bWU6c2VjcmV0"));
        if sent {
            ok("Content-Length: 2\r\n", "ok")
        } else {
            status("418 I'm a teapot")
        }
    });
    let address = address.replace("http://", "http://me:secret@");
    assert_eq!(get(&format!("{address}/x.zarr?key=secret")), Ok(b"ok".to_vec()));
    let text = why(get(&format!("{address}/y.zarr?key=secret")));
    assert!(text.contains("418") && !text.contains("secret"), "{text}");
    let nobody = why(get("http://me:secret@127.0.0.1:1/x.zarr?key=secret"));
    assert!(
        nobody.starts_with("no connection: ") && !nobody.contains("secret"),
        "{nobody}"
    );
}

#[test]
fn keys_stay_below_the_prefix() {
    let store = Arc::new(InMemory::new());
    let put = |key: &str| {
        let (store, key) = (Arc::clone(&store), ObjectPath::from(key));
        let put = async move { store.put(&key, "x".into()).await.map_err(|e| fault(&e)) };
        wait(&|| false, put).expect("an object");
    };
    put("a/x.zarr/zarr.json");
    put("outside");
    let remote = Remote {
        store,
        listed: None,
        prefix: "a/x.zarr".to_owned(),
    };
    let get = |key: &str| remote.get(key, Part::Whole, 100, &|| false).map(|object| object.size);
    assert_eq!(get("zarr.json"), Ok(1));
    assert_eq!(get("outside"), Err(Fault::Missing));
    for key in ["../../outside", "b//c", "./zarr.json"] {
        let Err(Fault::Other(why)) = get(key) else {
            panic!("{key}");
        };
        assert!(why.contains("expected a plain relative path"), "{why}");
    }
}
