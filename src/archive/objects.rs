//! An archive under a prefix of an object store: S3, Google Cloud Storage, Azure, or a folder through the same interface.
//!
//! `object_store` retries requests that fail temporarily, and continues an interrupted body, but not an interrupted page of a list.
//! It is asynchronous; each of our threads waits for its own request.

use super::check::{TreeError, is_fits, is_flown, is_navigation};
use super::storage::{Listing, Storage, StoredFile};
use crate::backoff::Backoff;
use crate::fits::{self, Problem};
use futures_util::stream::{self, StreamExt, TryStreamExt};
use object_store::aws::{AmazonS3, AmazonS3Builder};
use object_store::azure::{MicrosoftAzure, MicrosoftAzureBuilder};
use object_store::client::HttpError;
use object_store::gcp::{GoogleCloudStorage, GoogleCloudStorageBuilder};
use object_store::list::{PaginatedListOptions, PaginatedListResult, PaginatedListStore};
use object_store::local::LocalFileSystem;
use object_store::path::{DELIMITER, Path as ObjectPath};
use object_store::{
    BackoffConfig, GetOptions, GetRange, ObjectMeta, ObjectStore, ObjectStoreScheme, RetryConfig,
};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::error::Error;
use std::fmt::Display;
use std::io;
use std::iter;
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;
use url::Url;

/// Folders that are listed at the same time. A list comes in pages of 1000 objects, one after another.
const LISTS_AT_ONCE: usize = 16;
/// With a random wait of up to three times the previous one, these retries bridge about one minute without an answer.
const RETRIES: RetryConfig = RetryConfig {
    backoff: BackoffConfig {
        init_backoff: Duration::from_millis(500),
        max_backoff: Duration::from_secs(15),
        base: 3.0,
    },
    max_retries: 20,
    retry_timeout: Duration::from_secs(60),
};
/// Longest error text that is kept: servers answer with whole pages.
const LONGEST_ERROR: usize = 300;

#[derive(Debug)]
pub(super) struct Objects {
    url: String,
    store: Store,
    prefix: ObjectPath,
    runtime: Runtime,
}

#[derive(Debug)]
enum Store {
    S3(AmazonS3),
    GoogleCloud(GoogleCloudStorage),
    Azure(MicrosoftAzure),
    Folder(LocalFileSystem),
}

impl Objects {
    /// The objects under a URL, with credentials and server from the environment.
    ///
    /// # Errors
    /// If the URL is of no known object store, or the credentials are invalid.
    pub fn open(url: &str) -> Result<Self, TreeError> {
        let error = |found: String| {
            let expected = "the URL of an object store, such as s3://bucket/flight";
            TreeError::new(Path::new(url), expected, found)
        };
        let parsed = Url::parse(url).map_err(|cause| error(one_line(cause)))?;
        let parsed = ObjectStoreScheme::parse(&parsed);
        let (scheme, prefix) = parsed.map_err(|cause| error(one_line(cause)))?;
        let store = Store::open(&scheme, url).map_err(|cause| error(one_line(cause)))?;
        let runtime = Runtime::new().map_err(|cause| error(one_line(cause)))?;
        Ok(Self {
            url: url.into(),
            store,
            prefix,
            runtime,
        })
    }

    async fn objects(&self) -> object_store::Result<Vec<ObjectMeta>> {
        let Some(lists) = self.store.lists() else {
            let list = self.store.objects().list(Some(&self.prefix));
            return list.try_collect().await;
        };
        let folder = |path: &ObjectPath| match path.as_ref() {
            "" => String::new(),
            path => format!("{path}/"),
        };
        let prefix = folder(&self.prefix);
        let (mut objects, folders) = list_pages(lists, prefix, Some(DELIMITER)).await?;
        let below = folders.iter();
        let below = below.map(|path| list_pages(lists, folder(path), None));
        let mut below = stream::iter(below).buffer_unordered(LISTS_AT_ONCE);
        while let Some((found, _)) = below.try_next().await? {
            objects.extend(found);
        }
        Ok(objects)
    }

    /// Path relative to the archive; `None` for the object of the prefix itself, and for hidden files.
    fn relative(&self, object: &ObjectMeta) -> Option<String> {
        let parts = object.location.prefix_match(&self.prefix)?;
        let parts: Vec<String> = parts.map(|part| part.as_ref().to_owned()).collect();
        let is_shown = |part: &String| !part.starts_with('.');
        (!parts.is_empty() && parts.iter().all(is_shown)).then(|| parts.join("/"))
    }

    fn get(&self, file: &str, options: GetOptions) -> Result<Vec<u8>, Problem> {
        let fetched = self.runtime.block_on(async {
            let location = ObjectPath::parse(format!("{}/{file}", self.prefix))?;
            let found = self.store.objects().get_opts(&location, options).await?;
            match fits::check_length(found.meta.size) {
                Ok(()) => Ok(Ok(found.bytes().await?)),
                Err(problem) => Ok(Err(problem)),
            }
        });
        let bytes = fetched.map_err(|cause: object_store::Error| Problem::Io {
            action: "read",
            cause: io_error(cause),
        })?;
        Ok(bytes?.into())
    }
}

impl Storage for Objects {
    fn list(&self) -> Result<Listing, TreeError> {
        let error = |found| {
            TreeError::new(
                Path::new(&self.url),
                "files whose names end in .fits",
                found,
            )
        };
        let objects = self.runtime.block_on(self.objects());
        let objects = objects.map_err(|cause| error(one_line(cause)))?;
        let mut listing = Listing::default();
        for object in objects {
            let Some(file) = self.relative(&object) else {
                continue;
            };
            let path = Path::new(&file);
            if is_fits(path) {
                let written = object.last_modified.timestamp_nanos_opt();
                listing.frames.push(StoredFile {
                    file,
                    bytes: object.size,
                    written_ns: written.unwrap_or_default(),
                });
            } else if is_flown(path) {
                listing.flown.push(file);
            } else if is_navigation(path) && !file.contains('/') {
                listing.navigation.push(file);
            }
        }
        match listing.frames.is_empty() {
            true => Err(error("none".into())),
            false => Ok(listing),
        }
    }

    fn read(&self, file: &str) -> Result<Vec<u8>, Problem> {
        self.get(file, GetOptions::default())
    }

    fn read_start(&self, file: &StoredFile) -> Result<Vec<u8>, Problem> {
        // An empty object has no range.
        if file.bytes == 0 {
            return Ok(Vec::new());
        }
        let options = GetOptions {
            range: Some(GetRange::Bounded(0..fits::START_BYTES)),
            ..GetOptions::default()
        };
        self.get(&file.file, options)
    }
}

impl Store {
    /// The store of a URL, with credentials and server from the environment.
    fn open(scheme: &ObjectStoreScheme, url: &str) -> object_store::Result<Self> {
        Ok(match scheme {
            ObjectStoreScheme::AmazonS3 => {
                let builder = AmazonS3Builder::from_env().with_url(url);
                Self::S3(builder.with_retry(RETRIES).build()?)
            }
            ObjectStoreScheme::GoogleCloudStorage => {
                let builder = GoogleCloudStorageBuilder::from_env().with_url(url);
                Self::GoogleCloud(builder.with_retry(RETRIES).build()?)
            }
            ObjectStoreScheme::MicrosoftAzure => {
                let builder = MicrosoftAzureBuilder::from_env().with_url(url);
                Self::Azure(builder.with_retry(RETRIES).build()?)
            }
            ObjectStoreScheme::Local => Self::Folder(LocalFileSystem::new()),
            other => {
                return Err(object_store::Error::Generic {
                    store: "URL",
                    source: format!("{other:?} is not supported").into(),
                });
            }
        })
    }

    fn objects(&self) -> &dyn ObjectStore {
        match self {
            Self::S3(store) => store,
            Self::GoogleCloud(store) => store,
            Self::Azure(store) => store,
            Self::Folder(store) => store,
        }
    }

    /// The interface for lists by pages; `None` for a folder.
    fn lists(&self) -> Option<&dyn PaginatedListStore> {
        match self {
            Self::S3(store) => Some(store),
            Self::GoogleCloud(store) => Some(store),
            Self::Azure(store) => Some(store),
            Self::Folder(_) => None,
        }
    }
}

/// All objects whose names begin with a prefix; with a delimiter, those of its folder, and its subfolders.
async fn list_pages(
    store: &dyn PaginatedListStore,
    prefix: String,
    delimiter: Option<&'static str>,
) -> object_store::Result<(Vec<ObjectMeta>, BTreeSet<ObjectPath>)> {
    let mut options = PaginatedListOptions {
        delimiter: delimiter.map(Cow::from),
        ..PaginatedListOptions::default()
    };
    let (mut objects, mut folders) = (Vec::new(), BTreeSet::new());
    loop {
        let page = list_page(store, &prefix, &options).await?;
        objects.extend(page.result.objects);
        folders.extend(page.result.common_prefixes);
        if page.page_token.is_none() {
            return Ok((objects, folders));
        }
        options.page_token = page.page_token;
    }
}

/// Requests an interrupted page again, for as long as a request is repeated.
async fn list_page(
    store: &dyn PaginatedListStore,
    prefix: &str,
    options: &PaginatedListOptions,
) -> object_store::Result<PaginatedListResult> {
    let begun = Instant::now();
    let mut backoff = Backoff::NETWORK;
    loop {
        let page = store.list_paginated(Some(prefix), options.clone()).await;
        match page {
            Err(error) if is_cut_off(&error) && begun.elapsed() < RETRIES.retry_timeout => {
                tokio::time::sleep(backoff.wait()).await;
            }
            page => return page,
        }
    }
}

/// Whether the connection failed, rather than the storage refusing.
fn is_cut_off(error: &object_store::Error) -> bool {
    let mut causes = iter::successors(error.source(), |&cause| cause.source());
    causes.any(|cause| cause.is::<HttpError>())
}

fn io_error(cause: object_store::Error) -> io::Error {
    let text = one_line(&cause);
    io::Error::new(io::Error::from(cause).kind(), text)
}

/// An error in one line.
fn one_line(error: impl Display) -> String {
    let text = error.to_string();
    let words: Vec<&str> = text.split_whitespace().collect();
    let mut line = words.join(" ");
    if let Some((cut, _)) = line.char_indices().nth(LONGEST_ERROR) {
        line.truncate(cut);
        line.push_str(" ...");
    }
    line
}
