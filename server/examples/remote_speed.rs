//! How fast Zarr is read from a server on this machine, beside a plain client that gets the same bytes: `remote_speed` prints a line of JSON
//! with the shortest of five times of each, in seconds. The client drops the bytes, or keeps them in memory, as a reader must.
//!
//! The volume has 512³ samples of 16 bits, 256 MiB, in chunks of 64³ that are not compressed. Server and client share the processors.

use std::path::Path;
use std::time::Instant;

use axum::Router;
use axum::body::Bytes;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::response::IntoResponse;
use isopeel_volumes::{ReadError, open_dataset};
use tokio::runtime::Runtime;

const RUNS: usize = 5;
const SAMPLES: usize = 512;
const CHUNK: usize = 64;
const METADATA: &str = r#"{"zarr_format":3,"node_type":"array","shape":[512,512,512],"data_type":"uint16","fill_value":0,
    "chunk_grid":{"name":"regular","configuration":{"chunk_shape":[64,64,64]}},
    "chunk_key_encoding":{"name":"default"},"codecs":[{"name":"bytes","configuration":{"endian":"little"}}]}"#;

/// Serves the volume, and all its bytes as one object.
fn serve(runtime: &Runtime) -> std::io::Result<String> {
    let chunk = Bytes::from(vec![7; 2 * CHUNK.pow(3)]);
    let whole = Bytes::from(vec![7; 2 * SAMPLES.pow(3)]);
    let app = Router::new().fallback(move |request: Request| {
        let answer = match request.uri().path() {
            "/x.zarr/zarr.json" => METADATA.into_response(),
            "/whole" => whole.clone().into_response(),
            path if path.starts_with("/x.zarr/c/") => chunk.clone().into_response(),
            _ => StatusCode::NOT_FOUND.into_response(),
        };
        async { answer }
    });
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0"))?;
    let address = format!("http://{}", listener.local_addr()?);
    runtime.spawn(async { axum::serve(listener, app).await });
    Ok(address)
}

/// Seconds of the fastest run.
fn best<E>(mut work: impl FnMut() -> Result<(), E>) -> Result<f64, E> {
    let mut seconds = f64::INFINITY;
    for _ in 0..RUNS {
        let start = Instant::now();
        work()?;
        seconds = seconds.min(start.elapsed().as_secs_f64());
    }
    Ok(seconds)
}

/// Gets an object. Its bytes are kept until all are there, or dropped as they come.
async fn get(client: &reqwest::Client, url: String, keep: bool) -> Result<(), reqwest::Error> {
    let mut response = client.get(url).send().await?.error_for_status()?;
    let mut kept = Vec::with_capacity(if keep { 2 * SAMPLES.pow(3) } else { 0 });
    while let Some(bytes) = response.chunk().await? {
        if keep {
            kept.extend_from_slice(&bytes);
        }
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // The plain client asks for it as well.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let (server, runtime) = (Runtime::new()?, Runtime::new()?);
    let address = serve(&server)?;
    let client = reqwest::Client::builder().no_proxy().build()?;
    let whole = |keep| runtime.block_on(get(&client, format!("{address}/whole"), keep));
    let [dropped, kept] = [best(|| whole(false))?, best(|| whole(true))?];
    let chunks = (SAMPLES / CHUNK).pow(3);
    let each = best(|| {
        runtime.block_on(async {
            for chunk in 0..chunks {
                get(&client, format!("{address}/x.zarr/c/{chunk}"), false).await?;
            }
            Ok::<_, reqwest::Error>(())
        })
    })?;
    let dataset = open_dataset(Path::new(&format!("{address}/x.zarr")))?;
    let source = &dataset.fields[0].source;
    let read = best(|| source.load(0).map(|samples| assert_eq!(samples.len(), SAMPLES.pow(3))))
        .map_err(|error: ReadError| error)?;
    let line = serde_json::json!({"one_get": dropped, "one_get_kept": kept, "gets_of_chunks": each, "read": read});
    println!("{line}");
    Ok(())
}
