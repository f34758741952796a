//! S3, GCS, Azure and HTTP through object_store.
//!
//! Its retries are off, since [`Remote`](super::Remote) has its own patience. A runtime of one thread drives the sockets; the
//! calling thread waits and looks at its deadline and at the wish to cancel.

use std::future::Future;
use std::pin::pin;
use std::sync::Arc;

use futures_util::StreamExt;
use object_store::aws::{AmazonS3Builder, AmazonS3ConfigKey};
use object_store::azure::{AzureConfigKey, MicrosoftAzureBuilder};
use object_store::client::ClientConfigKey;
use object_store::gcp::{GoogleCloudStorageBuilder, GoogleConfigKey};
use object_store::http::HttpBuilder;
use object_store::path::Path;
use object_store::{Error, ObjectStore, ObjectStoreExt, PutMode, PutOptions, RetryConfig};
use tokio::runtime::{Builder, Runtime};

use super::options::{RemoteError, RemoteOptions};
use super::place::{Fault, POLL, Place, Until};

/// The service's own limits; ours are tighter.
const CONNECT_LIMIT: &str = "5 seconds";
const TRANSFER_LIMIT: &str = "1 day";

pub(super) struct Objects {
    store: Arc<dyn ObjectStore>,
    prefix: String,
    /// `None` only while it is being dropped.
    runtime: Option<Runtime>,
}

impl Drop for Objects {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // A name that is being looked up must not hold the build's end.
            runtime.shutdown_background();
        }
    }
}

impl Objects {
    pub(super) fn new(store: Arc<dyn ObjectStore>, prefix: &str) -> Result<Objects, String> {
        let runtime = Builder::new_multi_thread().worker_threads(1).thread_name("kiln-remote").enable_all().build();
        let runtime = Some(runtime.map_err(|error| error.to_string())?);
        Ok(Objects { store, prefix: prefix.trim_matches('/').to_owned(), runtime })
    }

    fn path(&self, key: &str) -> Path {
        if self.prefix.is_empty() { Path::from(key) } else { Path::from(format!("{}/{key}", self.prefix)) }
    }

    /// Waits for `work`, as long as it may take.
    fn wait<T>(&self, until: &Until<'_>, work: impl Future<Output = Result<T, Fault>>) -> Result<T, Fault> {
        let Some(runtime) = &self.runtime else { return Err(Fault::Cancelled) };
        runtime.block_on(async {
            let mut work = pin!(work);
            loop {
                let left = until.left()?;
                if let Ok(done) = tokio::time::timeout(left.min(POLL), &mut work).await {
                    return done;
                }
            }
        })
    }
}

/// What is not found: a key, which is a miss, or the whole bucket.
fn absent(error: &Error) -> Result<bool, Fault> {
    let mut cause: Option<&dyn std::error::Error> = Some(error);
    while let Some(now) = cause {
        if now.to_string().contains("NoSuchBucket") {
            return Err(Fault::Refused("there is no such bucket".into()));
        }
        cause = now.source();
    }
    Ok(false)
}

fn fault(error: Error) -> Fault {
    match error {
        Error::NotFound { .. } => absent(&error).err().unwrap_or_else(|| Fault::Refused("not found (404)".into())),
        Error::PermissionDenied { .. } => Fault::Refused("the server refuses (403)".into()),
        Error::Unauthenticated { .. } => Fault::Refused("the server wants other credentials (401)".into()),
        // The library's message repeats addresses and may hold a body's start: the innermost cause says enough.
        Error::Generic { source, .. } => {
            let mut innermost: &dyn std::error::Error = source.as_ref();
            while let Some(inner) = innermost.source() {
                innermost = inner;
            }
            let text: String = innermost.to_string().chars().filter(|c| !c.is_control()).take(200).collect();
            Fault::Transient(text)
        }
        other => {
            let text: String = other.to_string().chars().filter(|c| !c.is_control()).take(200).collect();
            Fault::Transient(text)
        }
    }
}

impl Place for Objects {
    fn get(
        &self,
        key: &str,
        limit: u64,
        until: &Until<'_>,
        push: &mut dyn FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<bool, Fault> {
        let path = self.path(key);
        self.wait(until, async {
            let found = match self.store.get(&path).await {
                Err(error @ Error::NotFound { .. }) => return absent(&error),
                other => other.map_err(fault)?,
            };
            let length = found.meta.size;
            if length > limit {
                return Err(Fault::Damaged(format!("{key} has {length} bytes; at most {limit} are expected")));
            }
            let mut stream = found.into_stream();
            let mut came = 0;
            while let Some(part) = stream.next().await {
                let part = part.map_err(fault)?;
                came += part.len() as u64;
                push(&part)?;
            }
            if came == length { Ok(true) } else { Err(Fault::Transient(format!("{key} was cut off"))) }
        })
    }

    fn has(&self, key: &str, until: &Until<'_>) -> Result<bool, Fault> {
        let path = self.path(key);
        self.wait(until, async {
            match self.store.head(&path).await {
                Ok(_) => Ok(true),
                Err(error @ Error::NotFound { .. }) => absent(&error),
                Err(error) => Err(fault(error)),
            }
        })
    }

    fn put(&self, key: &str, bytes: &Arc<[u8]>, create: bool, until: &Until<'_>) -> Result<bool, Fault> {
        let path = self.path(key);
        let payload = || object_store::PutPayload::from(bytes::Bytes::from_owner(Arc::clone(bytes)));
        self.wait(until, async {
            if create {
                let options = PutOptions::from(PutMode::Create);
                match self.store.put_opts(&path, payload(), options).await {
                    Ok(_) => return Ok(true),
                    Err(Error::AlreadyExists { .. } | Error::Precondition { .. }) => return Ok(false),
                    // HTTP, and stores that do not know conditions: look, then put.
                    Err(Error::NotImplemented { .. } | Error::NotSupported { .. }) => {
                        if self.store.head(&path).await.is_ok() {
                            return Ok(false);
                        }
                    }
                    Err(error) => return Err(fault(error)),
                }
            }
            self.store.put(&path, payload()).await.map(|_| true).map_err(fault)
        })
    }
}

/// Opens the service that the options' address names.
pub(super) fn open(options: &RemoteOptions) -> Result<Box<dyn Place>, RemoteError> {
    // Another library in the process may have chosen a provider of its own: that one serves too.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let told = |message: String| RemoteError::Settings { url: options.shown_url(), message };
    let (store, prefix) = service(options).map_err(|error| told(error.to_string()))?;
    Ok(Box::new(Objects::new(store, &prefix).map_err(told)?))
}

fn no_retry() -> RetryConfig {
    RetryConfig { max_retries: 0, ..RetryConfig::default() }
}

type Service = (Arc<dyn ObjectStore>, String);

/// Gives every setting to a builder: ours first, so that the user's win.
macro_rules! configured {
    ($builder:expr, $key:ident, $options:expr) => {{
        let mut builder = $builder
            .with_url(&$options.url)
            .with_retry(no_retry())
            .with_config($key::Client(ClientConfigKey::ConnectTimeout), CONNECT_LIMIT)
            .with_config($key::Client(ClientConfigKey::Timeout), TRANSFER_LIMIT);
        for (key, value) in &$options.settings {
            builder = builder.with_config(key.to_ascii_lowercase().parse::<$key>()?, value);
        }
        builder.build()?
    }};
}

fn service(options: &RemoteOptions) -> Result<Service, Error> {
    let (scheme, rest) = options.url.split_once("://").unwrap_or_default();
    let rest = rest.split(['?', '#']).next().unwrap_or_default();
    let (host, path) = rest.split_once('/').unwrap_or((rest, ""));
    let behind_bucket = || path.split_once('/').map_or("", |(_, path)| path).to_owned();
    let is_azure = ["dfs.core.windows.net", "blob.core.windows.net"].iter().any(|end| host.ends_with(end));
    Ok(match scheme {
        "s3" | "s3a" => {
            (Arc::new(configured!(AmazonS3Builder::from_env(), AmazonS3ConfigKey, options)), path.to_owned())
        }
        "https" if host.ends_with("amazonaws.com") || host.ends_with("r2.cloudflarestorage.com") => {
            let bucket_in_path = host.starts_with("s3") || host.ends_with("r2.cloudflarestorage.com");
            let prefix = if bucket_in_path { behind_bucket() } else { path.to_owned() };
            (Arc::new(configured!(AmazonS3Builder::from_env(), AmazonS3ConfigKey, options)), prefix)
        }
        "gs" => {
            let builder = GoogleCloudStorageBuilder::from_env();
            (Arc::new(configured!(builder, GoogleConfigKey, options)), path.to_owned())
        }
        "https" if is_azure => {
            (Arc::new(configured!(MicrosoftAzureBuilder::from_env(), AzureConfigKey, options)), behind_bucket())
        }
        "az" | "azure" | "adl" | "abfs" | "abfss" => {
            (Arc::new(configured!(MicrosoftAzureBuilder::from_env(), AzureConfigKey, options)), path.to_owned())
        }
        _ => (Arc::new(http(options)?), String::new()),
    })
}

fn http(options: &RemoteOptions) -> Result<object_store::http::HttpStore, Error> {
    let mut builder = HttpBuilder::new()
        .with_url(options.url.trim_end_matches('/'))
        .with_retry(no_retry())
        .with_config(ClientConfigKey::AllowHttp, "true")
        .with_config(ClientConfigKey::ConnectTimeout, CONNECT_LIMIT)
        .with_config(ClientConfigKey::Timeout, TRANSFER_LIMIT);
    for (key, value) in &options.settings {
        builder = builder.with_config(key.to_ascii_lowercase().parse()?, value);
    }
    builder.build()
}
