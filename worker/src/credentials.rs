//! What a client shows a coordinator, and how it knows that it speaks to the right one.

use reqwest::header::{AUTHORIZATION, HeaderValue};
use reqwest::{Certificate, ClientBuilder, RequestBuilder, Url};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Environment variable that holds a token.
pub const TOKEN_VARIABLE: &str = "PHOTONFARM_TOKEN";

/// Most bytes of a file with a token.
const TOKEN_BYTES: u64 = 4096;

/// A token, and the authority that the coordinator's certificate must come from. Neither debug text nor errors show
/// the token.
#[derive(Clone, Debug, Default)]
pub struct Credentials {
    /// `Bearer TOKEN`, marked as sensitive.
    token: Option<HeaderValue>,
    authorities: Vec<Certificate>,
}

/// Why credentials cannot be used.
#[derive(Debug, Error)]
pub enum CredentialsError {
    /// A file that cannot be read.
    #[error("cannot read {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What failed.
        source: std::io::Error,
    },
    /// A token that cannot be one.
    #[error("{0} holds no token: it is one line that begins with phf_")]
    Token(String),
    /// A file without certificates.
    #[error("{}: no certificates in PEM", .0.display())]
    Authority(PathBuf),
}

impl Credentials {
    /// The token in a file, else the one in the environment variable [`TOKEN_VARIABLE`]; and the authority's
    /// certificates in a PEM file, which then replace those that the system trusts.
    ///
    /// # Errors
    /// Files that cannot be read, or hold something else.
    pub fn load(token_file: Option<&Path>, authority: Option<&Path>) -> Result<Self, CredentialsError> {
        let token = match (token_file, std::env::var(TOKEN_VARIABLE)) {
            (Some(path), _) => Some((path.display().to_string(), read_token(path)?)),
            (None, Ok(token)) if !token.is_empty() => Some((TOKEN_VARIABLE.to_owned(), token)),
            (None, _) => None,
        };
        let token = token.map(|(from, token)| header(token.trim()).ok_or(CredentialsError::Token(from)));
        Ok(Self {
            token: token.transpose()?,
            authorities: authority.map(read_authority).transpose()?.unwrap_or_default(),
        })
    }

    /// Trusts the authority alone, if one is given.
    pub fn trust(&self, builder: ClientBuilder) -> ClientBuilder {
        if self.authorities.is_empty() {
            return builder;
        }
        let builder = builder.tls_built_in_root_certs(false);
        let add = |builder: ClientBuilder, authority: &Certificate| builder.add_root_certificate(authority.clone());
        self.authorities.iter().fold(builder, add)
    }

    /// Trusts the authority besides those that the system trusts: the object store may have either's certificate.
    pub(crate) fn trust_also(&self, builder: ClientBuilder) -> ClientBuilder {
        let add = |builder: ClientBuilder, authority: &Certificate| builder.add_root_certificate(authority.clone());
        self.authorities.iter().fold(builder, add)
    }

    /// Adds the token to a request to the coordinator. It goes nowhere else.
    pub fn sign(&self, request: RequestBuilder) -> RequestBuilder {
        match &self.token {
            Some(token) => request.header(AUTHORIZATION, token.clone()),
            None => request,
        }
    }

    /// Warns of a token that would travel in clear.
    pub fn warn_if_exposed(&self, coordinator: &Url) {
        let local = coordinator.host_str().is_some_and(|host| {
            let address = host.trim_matches(['[', ']']).parse::<IpAddr>();
            host == "localhost" || address.is_ok_and(|address| address.is_loopback())
        });
        if self.token.is_some() && coordinator.scheme() == "http" && !local {
            tracing::warn!("the token is sent to {coordinator} without encryption: whoever is between can read it");
        }
    }
}

fn header(token: &str) -> Option<HeaderValue> {
    let plain = token.starts_with("phf_") && token.bytes().all(|byte| byte.is_ascii_graphic());
    let mut value = HeaderValue::from_str(&format!("Bearer {token}"))
        .ok()
        .filter(|_| plain)?;
    value.set_sensitive(true);
    Some(value)
}

fn read(path: &Path, limit: u64) -> Result<Vec<u8>, CredentialsError> {
    use std::io::Read;
    let io = |source| CredentialsError::Io {
        path: path.to_owned(),
        source,
    };
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(io)?;
    file.take(limit).read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

fn read_token(path: &Path) -> Result<String, CredentialsError> {
    let bytes = read(path, TOKEN_BYTES)?;
    // Editors of some systems begin a text with a byte order mark.
    let text = bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(&bytes);
    String::from_utf8(text.to_vec()).map_err(|_| CredentialsError::Token(path.display().to_string()))
}

fn read_authority(path: &Path) -> Result<Vec<Certificate>, CredentialsError> {
    let bytes = read(path, 1 << 20)?;
    let certificates = Certificate::from_pem_bundle(&bytes).unwrap_or_default();
    if certificates.is_empty() {
        return Err(CredentialsError::Authority(path.to_owned()));
    }
    Ok(certificates)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_read_from_its_file_and_never_shown() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        for text in ["phf_0123abcd\n", "\u{feff}phf_0123abcd\r\n"] {
            std::fs::write(&path, text).unwrap();
            let credentials = Credentials::load(Some(&path), None).unwrap();
            let request = credentials.sign(reqwest::Client::new().get("http://127.0.0.1:1/"));
            assert_eq!(request.build().unwrap().headers()[AUTHORIZATION], "Bearer phf_0123abcd");
            assert!(!format!("{credentials:?}").contains("0123abcd"));
        }
    }

    #[test]
    fn what_is_no_token_is_refused_without_showing_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        for content in ["", "secret\n", "phf_a b", "phf_a\nphf_b", "phf_\u{e9}"] {
            std::fs::write(&path, content).unwrap();
            let message = Credentials::load(Some(&path), None).unwrap_err().to_string();
            assert!(message.contains("token") && !message.contains("secret"), "{message}");
        }
        let none = folder.path().join("none");
        assert!(matches!(
            Credentials::load(Some(&none), None),
            Err(CredentialsError::Io { .. })
        ));
        assert!(matches!(
            Credentials::load(None, Some(&path)),
            Err(CredentialsError::Authority(_))
        ));
    }
}
