//! Where a remote is, and how much patience it gets.

use std::path::PathBuf;
use std::time::Duration;

use super::folder::Folder;
use super::place::Place;
use super::sign::{PublicKey, SigningKey};

/// What a build may do with a remote.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RemoteMode {
    /// Take from it: for people.
    #[default]
    Read,
    /// Take from it and send to it what ran: for CI.
    Write,
}

/// A remote and how to use it.
#[derive(Clone, Debug)]
pub struct RemoteOptions {
    /// A folder, `file://`, `s3://bucket/prefix`, `gs://bucket/prefix`, `az://container/prefix`, `http://` or `https://`.
    pub url: String,
    /// Whether results are sent too.
    pub mode: RemoteMode,
    /// How long a request may take beside the transfer of its bytes.
    pub request_limit: Duration,
    /// Bytes a second that all transfers at once are expected to carry: below that, time counts as lost; 1 MiB.
    pub min_rate: f64,
    /// How often a request is tried.
    pub attempts: u32,
    /// How much time a build may lose by failures and slowness until it leaves the remote alone; summed over threads.
    pub lost_limit: Duration,
    /// How long the end of a build waits for what is still to be sent.
    pub upload_limit: Duration,
    /// Longest blob that is taken, bytes.
    pub longest_blob: u64,
    /// If there are any: only records signed by one of these are taken.
    pub trusted_keys: Vec<PublicKey>,
    /// Signs the records that are sent.
    pub sign_with: Option<SigningKey>,
    /// The share of hits that [`Engine::check_claims`](crate::Engine::check_claims) recomputes, 0 to 1.
    pub check_share: f64,
    /// Which share: a number that whoever wrote the records must not know. `None` draws one for each process.
    pub check_seed: Option<u64>,
    /// Settings of the service by object_store's names, such as `endpoint` and `region`; credentials come from the environment
    /// (`AWS_*`, `GOOGLE_*`, `AZURE_*`) or from here.
    pub settings: Vec<(String, String)>,
}

/// Why a remote cannot be opened: a matter of settings, not of the network.
#[derive(Debug, thiserror::Error)]
pub enum RemoteError {
    /// No such scheme.
    #[error("`{url}` is no folder and no s3://, gs://, az://, http:// or https:// address")]
    UnknownScheme {
        /// As it is shown.
        url: String,
    },
    /// Left out of this build.
    #[error("{what} needs kiln's feature `remote`, which this build lacks")]
    NoFeature {
        /// What was asked for.
        what: &'static str,
    },
    /// The service's own library objects.
    #[error("remote cache {url}: {message}")]
    Settings {
        /// As it is shown.
        url: String,
        /// What it says.
        message: String,
    },
}

impl RemoteOptions {
    /// The remote at `url`, with all defaults.
    pub fn new(url: impl Into<String>) -> RemoteOptions {
        RemoteOptions {
            url: url.into(),
            mode: RemoteMode::Read,
            request_limit: Duration::from_secs(5),
            min_rate: (1 << 20) as f64,
            attempts: 3,
            lost_limit: Duration::from_secs(15),
            upload_limit: Duration::from_secs(60),
            longest_blob: 4 << 30,
            trusted_keys: Vec::new(),
            sign_with: None,
            check_share: 0.05,
            check_seed: None,
            settings: Vec::new(),
        }
    }

    /// The address without a password or a query in it.
    pub fn shown_url(&self) -> String {
        let url = self.url.split(['?', '#']).next().unwrap_or_default();
        match url.split_once("://") {
            Some((scheme, rest)) if scheme.starts_with("http") => {
                let (host, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
                format!("{scheme}://{}{path}", host.rsplit('@').next().unwrap_or_default())
            }
            _ => url.to_owned(),
        }
    }

    pub(super) fn place(&self) -> Result<Box<dyn Place>, RemoteError> {
        if cfg!(not(feature = "remote")) && (self.sign_with.is_some() || !self.trusted_keys.is_empty()) {
            return Err(RemoteError::NoFeature { what: "a signed remote cache" });
        }
        match self.url.split_once("://") {
            None if !self.url.is_empty() => Ok(Box::new(Folder::new(PathBuf::from(&self.url)))),
            Some(("file", path)) => Ok(Box::new(Folder::new(PathBuf::from(path)))),
            #[cfg(feature = "remote")]
            Some(("s3" | "s3a" | "gs" | "az" | "azure" | "adl" | "abfs" | "abfss" | "http" | "https", _)) => {
                super::objects::open(self)
            }
            #[cfg(not(feature = "remote"))]
            Some(("s3" | "s3a" | "gs" | "az" | "azure" | "adl" | "abfs" | "abfss" | "http" | "https", _)) => {
                Err(RemoteError::NoFeature { what: "a remote cache that is no folder" })
            }
            _ => Err(RemoteError::UnknownScheme { url: self.shown_url() }),
        }
    }
}
