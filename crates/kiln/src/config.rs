//! The user's own settings: which remote cache to use, whom to trust, how large a cache may grow. None of it changes what a build
//! gives, so none of it belongs into a pipeline.
//!
//! ```toml
//! [cache]                         # limits of `kiln cache gc`
//! max_size = "20 GB"
//! max_age = "30d"
//!
//! [remote]
//! url = "s3://studio-cache/kiln"  # a folder, s3://, gs://, az://, http://, https://
//! mode = "read"                   # "write" for CI
//! trusted_keys = ["d75a9801..."]  # if any: only records signed by one of them are taken
//! sign_with = "/etc/kiln/key"     # a file of 64 hexadecimal digits
//! check = 0.05                    # the share of remote hits that `--verify --remote` recomputes
//! patience = "15s"                # what a build may lose to a remote that fails or is slow
//! settings = { region = "eu-central-1" }
//!
//! [slurm]                         # `build --on slurm`; every key may be left out
//! partition = "render"
//! account = "assets"
//! gres = "gpu:1"                  # what GPU stages ask for
//! time = "2:00:00"                # of an array element: `batch` stages
//! mem = "8G"
//! cpus = 4
//! batch = 8                       # assets an array element
//! limit = 200                     # elements of one array at a time
//! max_array = 1000                # MaxArraySize of slurm.conf, less one
//! sbatch = ["--qos=low"]          # further arguments
//! ```
//!
//! It lies at `$KILN_CONFIG`, else `$XDG_CONFIG_HOME/kiln/config.toml`, `~/.config/kiln/config.toml`, or on Windows
//! `%APPDATA%\kiln\config.toml`. A flag wins over `KILN_REMOTE` and `KILN_REMOTE_MODE`, and those over the file; the address `off` is none.

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::Duration;

use kiln_engine::{PublicKey, RemoteMode, RemoteOptions, SigningKey, SlurmOptions};
use serde::Deserialize;

/// The file as it is written.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Limits of the local cache.
    #[serde(default)]
    pub cache: CacheConfig,
    /// The remote.
    #[serde(default)]
    pub remote: RemoteConfig,
    /// `build --on slurm`.
    #[serde(default)]
    pub slurm: SlurmConfig,
}

/// `[cache]`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CacheConfig {
    /// A size such as `20 GB`.
    pub max_size: Option<String>,
    /// A time such as `30d`.
    pub max_age: Option<String>,
}

/// `[remote]`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoteConfig {
    /// Where it is.
    pub url: Option<String>,
    /// `read` or `write`.
    pub mode: Option<String>,
    /// Public keys, 64 hexadecimal digits each.
    #[serde(default)]
    pub trusted_keys: Vec<String>,
    /// File of the secret key.
    pub sign_with: Option<PathBuf>,
    /// 0 to 1.
    pub check: Option<f64>,
    /// A time such as `15s`.
    pub patience: Option<String>,
    /// The service's own settings.
    #[serde(default)]
    pub settings: BTreeMap<String, String>,
}

/// `[slurm]`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SlurmConfig {
    /// `--partition`.
    pub partition: Option<String>,
    /// `--account`.
    pub account: Option<String>,
    /// `--gres` of GPU stages; empty: none.
    pub gres: Option<String>,
    /// `--time`.
    pub time: Option<String>,
    /// `--mem`.
    pub mem: Option<String>,
    /// `--cpus-per-task`.
    pub cpus: Option<u32>,
    /// Assets an array element.
    pub batch: Option<usize>,
    /// Elements of one array at a time.
    pub limit: Option<usize>,
    /// Longest array.
    pub max_array: Option<usize>,
    /// Further arguments of `sbatch`.
    #[serde(default)]
    pub sbatch: Vec<String>,
}

/// A setting that makes no sense, with where it stands.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file is there, or is asked for, and cannot be read.
    #[error("cannot read {}: {error}", path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        error: std::io::Error,
    },
    /// The file is no such configuration; the message shows the line.
    #[error("{}: {error}", path.display())]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        error: Box<toml::de::Error>,
    },
    /// One value makes no sense.
    #[error("{place}: {message}")]
    Value {
        /// The key or variable.
        place: &'static str,
        /// What is wrong, and what is expected.
        message: String,
    },
}

fn value_error(place: &'static str, message: impl Into<String>) -> ConfigError {
    ConfigError::Value { place, message: message.into() }
}

/// Where the file lies; `true` if it was asked for by name.
fn location() -> Option<(PathBuf, bool)> {
    let folder = |name: &str| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(path) = folder("KILN_CONFIG") {
        return Some((path, true));
    }
    let home = || folder("HOME").map(|home| home.join(".config"));
    let base = folder("XDG_CONFIG_HOME").or_else(home).or_else(|| folder("APPDATA"))?;
    Some((base.join("kiln").join("config.toml"), false))
}

impl Config {
    /// The user's file; empty if there is none.
    ///
    /// # Errors
    /// It cannot be read, or says something else.
    pub fn load() -> Result<Config, ConfigError> {
        let Some((path, asked_for)) = location() else { return Ok(Config::default()) };
        match fs::read_to_string(&path) {
            Ok(text) => Config::parse(&text, &path),
            Err(error) if error.kind() == ErrorKind::NotFound && !asked_for => Ok(Config::default()),
            Err(error) => Err(ConfigError::Unreadable { path, error }),
        }
    }

    fn parse(text: &str, path: &Path) -> Result<Config, ConfigError> {
        toml::from_str(text).map_err(|error| ConfigError::Malformed { path: path.to_owned(), error: Box::new(error) })
    }

    /// How to hand stages to Slurm.
    ///
    /// # Errors
    /// A number is zero that must not be.
    pub fn slurm(&self) -> Result<SlurmOptions, ConfigError> {
        let (file, defaults) = (self.slurm.clone(), SlurmOptions::default());
        let positive = |place, value: Option<usize>, default| match value {
            Some(0) => Err(value_error(place, "expected 1 or more")),
            value => Ok(value.unwrap_or(default)),
        };
        Ok(SlurmOptions {
            partition: file.partition,
            account: file.account,
            gres: file.gres.unwrap_or(defaults.gres),
            time: file.time,
            mem: file.mem,
            cpus: file.cpus,
            batch: positive("slurm.batch", file.batch, defaults.batch)?,
            limit: file.limit.unwrap_or(defaults.limit),
            max_array: positive("slurm.max_array", file.max_array, defaults.max_array)?,
            sbatch: file.sbatch,
        })
    }

    /// The remote to use: `url` and `mode` as typed, else as the environment has them, else as the file has them.
    ///
    /// # Errors
    /// A value makes no sense, or the key cannot be read.
    pub fn remote(&self, url: Option<&str>, mode: Option<RemoteMode>) -> Result<Option<RemoteOptions>, ConfigError> {
        let variable = |name: &str| env::var(name).ok().filter(|value| !value.is_empty());
        let url = url.map(str::to_owned).or_else(|| variable("KILN_REMOTE")).or_else(|| self.remote.url.clone());
        let Some(url) = url.filter(|url| url != "off" && !url.is_empty()) else { return Ok(None) };
        let mode = match (mode, variable("KILN_REMOTE_MODE"), &self.remote.mode) {
            (Some(mode), ..) => mode,
            (None, Some(text), _) => parse_mode("KILN_REMOTE_MODE", &text)?,
            (None, None, Some(text)) => parse_mode("remote.mode", text)?,
            (None, None, None) => RemoteMode::Read,
        };
        let mut options = RemoteOptions { mode, ..RemoteOptions::new(url) };
        for text in &self.remote.trusted_keys {
            let key: Result<PublicKey, _> = text.parse();
            options.trusted_keys.push(
                key.map_err(|_| value_error("remote.trusted_keys", format!("`{text}` is not 64 hexadecimal digits")))?,
            );
        }
        if let Some(path) = self.remote.sign_with.as_ref().filter(|_| mode == RemoteMode::Write) {
            options.sign_with = Some(signing_key(path)?);
        }
        if let Some(share) = self.remote.check {
            if !(0.0..=1.0).contains(&share) {
                return Err(value_error("remote.check", format!("{share} is not between 0 and 1")));
            }
            options.check_share = share;
        }
        if let Some(text) = &self.remote.patience {
            options.lost_limit = parse_age(text).map_err(|message| value_error("remote.patience", message))?;
        }
        options.settings = self.remote.settings.clone().into_iter().collect();
        Ok(Some(options))
    }
}

/// The secret key in a file of 64 hexadecimal digits.
///
/// # Errors
/// It cannot be read, or is something else.
pub fn signing_key(path: &Path) -> Result<SigningKey, ConfigError> {
    let text = fs::read_to_string(path).map_err(|error| ConfigError::Unreadable { path: path.to_owned(), error })?;
    text.parse()
        .map_err(|_| value_error("remote.sign_with", format!("{} does not hold 64 hexadecimal digits", path.display())))
}

fn parse_mode(place: &'static str, text: &str) -> Result<RemoteMode, ConfigError> {
    match text {
        "read" => Ok(RemoteMode::Read),
        "write" => Ok(RemoteMode::Write),
        _ => Err(value_error(place, format!("`{text}` is neither `read` nor `write`"))),
    }
}

/// A number and what is behind it.
fn split_number(text: &str) -> Option<(f64, String)> {
    let text = text.trim();
    let end = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let number: f64 = text[..end].parse().ok()?;
    Some((number, text[end..].trim().to_ascii_lowercase()))
}

/// A size: bytes, or a number with kB, MB, GB, TB (thousands) or KiB, MiB, GiB, TiB (1024).
///
/// # Errors
/// What is expected.
pub fn parse_size(text: &str) -> Result<u64, String> {
    let wrong = || format!("`{text}` is no size; expected such as `20 GB` or `512 MiB`");
    let (number, unit) = split_number(text).ok_or_else(wrong)?;
    let factor: f64 = match unit.as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "t" | "tb" => 1e12,
        "kib" => (1_u64 << 10) as f64,
        "mib" => (1_u64 << 20) as f64,
        "gib" => (1_u64 << 30) as f64,
        "tib" => (1_u64 << 40) as f64,
        _ => return Err(wrong()),
    };
    Ok((number * factor) as u64)
}

/// A time span: a number with s, m, h, d or w.
///
/// # Errors
/// What is expected.
pub fn parse_age(text: &str) -> Result<Duration, String> {
    let wrong = || format!("`{text}` is no time span; expected such as `30d`, `12h` or `2w`");
    let (number, unit) = split_number(text).ok_or_else(wrong)?;
    let factor = match unit.as_str() {
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        "d" | "day" | "days" => 86_400.0,
        "w" => 7.0 * 86_400.0,
        _ => return Err(wrong()),
    };
    Duration::try_from_secs_f64(number * factor).map_err(|_| wrong())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_spans_are_read_as_people_write_them() {
        let sizes = ["0", "12", "20GB", "1.5 kB", "512 MiB", "2tb"].map(|text| parse_size(text).unwrap());
        assert_eq!(sizes, [0, 12, 20_000_000_000, 1500, 512 << 20, 2_000_000_000_000]);
        let ages = ["30d", "12h", "90m", "2w", "0.5 d"].map(|text| parse_age(text).unwrap().as_secs());
        assert_eq!(ages, [2_592_000, 43_200, 5400, 1_209_600, 43_200]);
        for wrong in ["", "GB", "-1 GB", "1 XB", "1.2.3", "1e9 GB", "ä"] {
            assert!(parse_size(wrong).is_err(), "{wrong}");
        }
        for wrong in ["", "30", "d", "1 year", "-1d"] {
            assert!(parse_age(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_file_says_which_remote_and_whom_to_trust() {
        let parse = |text: &str| Config::parse(text, Path::new("config.toml"));
        let config =
            parse("[remote]\nurl = 's3://b/p'\nmode = 'write'\ncheck = 0.5\nsettings = { region = 'x' }").unwrap();
        let options = config.remote(Some("/share"), None).unwrap().unwrap();
        assert_eq!((options.url.as_str(), options.mode, options.check_share), ("/share", RemoteMode::Write, 0.5));
        assert_eq!(options.settings, [("region".to_owned(), "x".to_owned())]);
        assert!(config.remote(Some("off"), None).unwrap().is_none());
        assert_eq!(config.remote(Some("x"), Some(RemoteMode::Read)).unwrap().unwrap().mode, RemoteMode::Read);
        for (text, expected) in [
            ("[remote]\nmode = 'rw'", "neither `read` nor `write`"),
            ("[remote]\ntrusted_keys = ['ab']", "not 64 hexadecimal digits"),
            ("[remote]\ncheck = 2.0", "not between 0 and 1"),
            ("[remote]\npatience = 'much'", "no time span"),
        ] {
            let told = parse(text).unwrap().remote(Some("x"), None).unwrap_err().to_string();
            assert!(told.contains(expected), "{told}");
        }
        let slurm = parse("[slurm]\npartition = 'render'\nbatch = 8\nsbatch = ['--qos=low']").unwrap().slurm().unwrap();
        assert_eq!((slurm.partition.as_deref(), slurm.batch, slurm.gres.as_str()), (Some("render"), 8, "gpu:1"));
        assert!(parse("[slurm]\nbatch = 0").unwrap().slurm().unwrap_err().to_string().contains("slurm.batch"));
        assert!(parse("[remote]\nulr = 'x'").unwrap_err().to_string().contains("ulr"));
    }
}
