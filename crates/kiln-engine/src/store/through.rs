//! Reading through to the remote, and sending to it: the store's side of [`remote`](crate::remote).

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::{BLOB_HEADER, LAYOUT, Store, blob_header, lock};
use crate::disk::{self, Writer};
use crate::hash::{ContentHash, Fingerprint};
use crate::remote::claim::{self, CLAIM_LIMIT};
use crate::remote::place::{Fault, Sink};
use crate::remote::{Offer, Remote, RemoteReport};
use crate::report::Record;

/// Threads that send.
const SENDERS: usize = 2;

/// Lists that a remote keeps for one declared fingerprint, under numbers: HTTP cannot list a folder.
const SLOTS: usize = 8;

fn key(folder: &str, hex: &str) -> String {
    format!("{LAYOUT}/{folder}/{}/{hex}", hex.split_at(2).0)
}

fn slot_key(declared: &Fingerprint, slot: usize) -> String {
    format!("{}/{slot}", key("lists", &declared.hex()))
}

/// A blob on its way into a temporary file.
struct BlobSink<'a> {
    store: &'a Store,
    hash: ContentHash,
    /// What the record says.
    length: u64,
    header: Vec<u8>,
    came: u64,
    hasher: blake3::Hasher,
    file: Option<(PathBuf, Writer)>,
}

impl<'a> BlobSink<'a> {
    fn new(store: &'a Store, hash: ContentHash, length: u64) -> BlobSink<'a> {
        BlobSink { store, hash, length, header: Vec::new(), came: 0, hasher: blake3::Hasher::new(), file: None }
    }

    fn check_header(&mut self) -> Result<(), Fault> {
        if self.header[..] != blob_header(&self.hash, self.length)[..] {
            return Err(Fault::Damaged(format!("blob {} has a wrong header", self.hash.short())));
        }
        Ok(())
    }

    fn discard(&mut self) {
        if let Some((path, writer)) = self.file.take() {
            drop(writer);
            let _ = disk::remove(&path);
        }
    }
}

impl Drop for BlobSink<'_> {
    fn drop(&mut self) {
        self.discard();
    }
}

impl Sink for BlobSink<'_> {
    fn restart(&mut self) -> Result<(), Fault> {
        self.discard();
        let path = self.store.temporary();
        let writer = Writer::create(&path)?;
        self.file = Some((path, writer));
        self.header.clear();
        self.came = 0;
        self.hasher.reset();
        Ok(())
    }

    fn push(&mut self, mut bytes: &[u8]) -> Result<(), Fault> {
        if let Some((_, writer)) = &mut self.file {
            writer.push(bytes)?;
        }
        if self.header.len() < BLOB_HEADER {
            let (head, rest) = bytes.split_at(bytes.len().min(BLOB_HEADER - self.header.len()));
            self.header.extend_from_slice(head);
            bytes = rest;
            if self.header.len() == BLOB_HEADER {
                self.check_header()?;
            }
        }
        self.came += bytes.len() as u64;
        self.hasher.update(bytes);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), Fault> {
        let whole = self.header.len() == BLOB_HEADER && self.length == self.came;
        if !whole || *self.hasher.finalize().as_bytes() != self.hash.0 {
            return Err(Fault::Damaged(format!("blob {} does not verify", self.hash.short())));
        }
        let Some((path, writer)) = self.file.take() else { return Ok(()) };
        let named = writer.finish(false).and_then(|()| self.store.name_blob(&path, &self.hash));
        if named.is_err() {
            let _ = disk::remove(&path);
        }
        Ok(named?)
    }
}

impl Store {
    /// What the remote did during the last build; `None` without one.
    pub(crate) fn remote_report(&self) -> Option<RemoteReport> {
        self.remote.as_ref().map(Remote::report)
    }

    // --- taking ---

    /// `true` if it came; says so once if our own disk is the trouble.
    fn came(&self, result: Result<bool, Fault>) -> bool {
        match result {
            Ok(came) => came,
            Err(Fault::Local(error)) => {
                let mut warnings = lock(&self.warnings);
                let message = format!("{error}; what the remote cache has cannot be kept");
                if !warnings.contains(&message) {
                    warnings.push(message);
                }
                false
            }
            // The ledger has it.
            Err(_) => false,
        }
    }

    /// A record of the remote, kept as our own if it is well-formed and all its blobs are here or come and verify.
    pub(super) fn claimed_record(&self, fingerprint: &Fingerprint) -> Option<Record> {
        let remote = self.remote.as_ref()?;
        let options = remote.options();
        let key = key("actions", &fingerprint.hex());
        let mut bytes = Vec::new();
        if !self.came(remote.fetch(&key, CLAIM_LIMIT, &mut bytes)) {
            return None;
        }
        let opened = claim::open_record(&bytes, fingerprint, &options.trusted_keys, options.longest_blob);
        let record = opened.map_err(|why| remote.blame(&key, why)).ok()?;
        let blobs: BTreeMap<ContentHash, u64> = record.outputs.iter().map(|out| (out.hash, out.length)).collect();
        for output in &record.outputs {
            if blobs.get(&output.hash) != Some(&output.length) {
                remote.blame(&key, "gives one blob two lengths");
                return None;
            }
        }
        for (hash, length) in blobs {
            match self.verify_blob(&hash) {
                Some(here) if here == length => {}
                Some(_) => {
                    remote.blame(&key, "gives a blob another length than it has");
                    return None;
                }
                None => {
                    if !self.came(self.claimed_blob(&hash, length)) {
                        return None;
                    }
                }
            }
        }
        if let Err(error) = self.put_local_record(&record, false, false) {
            self.came(Err(Fault::Local(error)));
            return None;
        }
        self.keep_guess(&record);
        remote.count_hit();
        // Another process may have been faster, with a record of its own.
        let record = self.local_record(fingerprint)?;
        lock(&self.claims).insert(*fingerprint);
        Some(record)
    }

    /// Fetches a blob into the store; whether it came.
    pub(super) fn claimed_blob(&self, hash: &ContentHash, length: u64) -> Result<bool, Fault> {
        let Some(remote) = &self.remote else { return Ok(false) };
        let limit = length.saturating_add(BLOB_HEADER as u64);
        let mut sink = BlobSink::new(self, *hash, length);
        remote.fetch(&key("blobs", &hash.hex()), limit, &mut sink)
    }

    /// Lists of the remote, each fetched when it is asked for. They are guesses: one is kept when a record is found by it.
    pub(super) fn claimed_lists(&self, declared: Fingerprint) -> impl Iterator<Item = Vec<String>> {
        let slots = if self.remote.is_some() { 0..SLOTS } else { 0..0 };
        // The first that is absent is the last; one that is damaged is passed by.
        slots.map_while(move |slot| self.claimed_list(&declared, slot)).flatten()
    }

    /// `None` if there is no such slot, `Some(None)` if what lies there is no list.
    fn claimed_list(&self, declared: &Fingerprint, slot: usize) -> Option<Option<Vec<String>>> {
        let remote = self.remote.as_ref()?;
        let key = slot_key(declared, slot);
        let mut bytes = Vec::new();
        if !self.came(remote.fetch(&key, CLAIM_LIMIT, &mut bytes)) {
            return None;
        }
        let opened = claim::open_list(&bytes).map_err(|why| remote.blame(&key, why)).ok();
        if let Some(list) = &opened {
            lock(&self.guesses).insert(list.clone(), *declared);
        }
        Some(opened)
    }

    /// Keeps the list by which a record was found, if it came from the remote too.
    fn keep_guess(&self, record: &Record) {
        let list: Vec<String> = record.discovered.iter().map(|(path, _)| path.clone()).collect();
        let declared = lock(&self.guesses).remove(&list);
        if let Some(declared) = declared
            && let Err(error) = self.put_local_list(&declared, &list, false)
        {
            self.came(Err(Fault::Local(error)));
        }
    }

    // --- checking ---
    // `Engine::check_claims` runs what `wants_check`, compares the records' outputs, and `refute`s where they differ.

    /// Whether this record came from the remote during the last build and belongs to the sample that is recomputed.
    ///
    /// The sample goes by a hash of the fingerprint with the seed: by the fingerprint alone a liar would know which of its records
    /// nobody will ever check. Each process draws its own, so that many runs and many machines together check everything.
    pub(crate) fn wants_check(&self, fingerprint: &Fingerprint) -> bool {
        let Some(remote) = &self.remote else { return false };
        let salted = ContentHash::of(&[&remote.check_seed().to_le_bytes()[..], &fingerprint.0].concat());
        let number = u32::from_le_bytes([salted.0[0], salted.0[1], salted.0[2], salted.0[3]]);
        let chosen = f64::from(number) < remote.options().check_share * (f64::from(u32::MAX) + 1.0);
        chosen && self.is_claim(fingerprint)
    }

    /// Whether this record came from the remote during the last build.
    pub(crate) fn is_claim(&self, fingerprint: &Fingerprint) -> bool {
        lock(&self.claims).contains(fingerprint)
    }

    /// Takes note that running an action gave `made` where the remote claimed something else: `made` is the truth from now on,
    /// here, and in the remote if we may write.
    /// To be called while a build is at work, as sending is.
    pub(crate) fn refute(&self, made: &Record, sync: bool) -> Result<(), crate::error::IoError> {
        lock(&self.claims).remove(&made.fingerprint);
        if let Some(remote) = &self.remote {
            remote.disown(key("actions", &made.fingerprint.hex()));
        }
        self.put_record(made, true, sync).map(|_| ())
    }

    // --- sending ---

    pub(super) fn offer_record(&self, fingerprint: Fingerprint, replace: bool) {
        if let Some(remote) = &self.remote {
            remote.offer(Offer::Record { fingerprint, replace });
        }
    }

    pub(super) fn offer_list(&self, declared: Fingerprint, list: &[String]) {
        if let Some(remote) = &self.remote
            && remote.writes()
        {
            remote.offer(Offer::List { declared, list: list.to_vec() });
        }
    }

    /// Does `work` with the remote at hand, and sends beside it what it offers.
    pub(super) fn with_uploads<R>(&self, cancel: &Arc<AtomicBool>, work: impl FnOnce() -> R) -> R {
        let Some(remote) = &self.remote else { return work() };
        remote.begin(cancel);
        let result = if remote.writes() {
            std::thread::scope(|scope| {
                for _ in 0..SENDERS {
                    scope.spawn(|| self.send_all(remote));
                }
                // Dropped after a panic too: the senders must end for the panic to go on.
                let _finish = Finish(remote);
                work()
            })
        } else {
            work()
        };
        for warning in remote.end() {
            self.warn(warning);
        }
        result
    }

    fn send_all(&self, remote: &Remote) {
        while let Some(offer) = remote.next_offer() {
            // What fails is in the ledger; what our own disk lost meanwhile is nothing to send.
            let _ = match &offer {
                Offer::Record { fingerprint, replace } => self.send_record(remote, fingerprint, *replace),
                Offer::List { declared, list } => self.send_list(remote, declared, list),
            };
            remote.done_offer();
        }
    }

    fn send_record(&self, remote: &Remote, fingerprint: &Fingerprint, replace: bool) -> Result<(), Fault> {
        let Some(record) = self.local_record(fingerprint) else { return Ok(()) };
        let blobs: BTreeMap<ContentHash, u64> = record.outputs.iter().map(|out| (out.hash, out.length)).collect();
        for (hash, length) in blobs {
            let key = key("blobs", &hash.hex());
            if remote.has(&key)? {
                continue;
            }
            let Some(bytes) = self.local_blob(&hash) else { return Ok(()) };
            let file: Arc<[u8]> = [&blob_header(&hash, length)[..], &bytes].concat().into();
            drop(bytes);
            remote.send(&key, &file, false)?;
        }
        let object = claim::record_object(&record, remote.options().sign_with.as_ref()).into();
        if remote.send(&key("actions", &fingerprint.hex()), &object, !replace)? {
            remote.count_sent();
        }
        Ok(())
    }

    fn send_list(&self, remote: &Remote, declared: &Fingerprint, list: &[String]) -> Result<(), Fault> {
        let object: Arc<[u8]> = claim::list_object(list).into();
        for slot in 0..SLOTS {
            let key = slot_key(declared, slot);
            // The second look is for a slot that another writer took in between.
            for _ in 0..2 {
                match remote.peek(&key, CLAIM_LIMIT)? {
                    Some(there) if there[..] == object[..] => return Ok(()),
                    Some(there) if claim::open_list(&there).is_ok() => break,
                    there => {
                        if remote.send(&key, &object, there.is_none())? {
                            return Ok(());
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

/// Waits for the uploads when it goes.
struct Finish<'a>(&'a Remote);

impl Drop for Finish<'_> {
    fn drop(&mut self) {
        self.0.finish_sending();
    }
}
