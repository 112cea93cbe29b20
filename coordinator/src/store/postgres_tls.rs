//! Encrypted connections to PostgreSQL, where the URL asks for them by `sslmode=require`.

use super::StoreError;
use std::sync::Arc;
use tokio_postgres::Config;
use tokio_postgres::config::SslMode;
use tokio_postgres_rustls::MakeRustlsConnect;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// Makes connections of the kind that `config` asks for. Encrypted ones are made to servers with a certificate of an authority
/// that the system trusts, in the name of the host. Without `sslmode=require` nothing is encrypted, whatever the server offers.
pub(super) fn connector(config: &mut Config, place: &str) -> Result<MakeRustlsConnect, StoreError> {
    let foreign = |reason: String| StoreError::Foreign {
        place: place.into(),
        reason,
    };
    let mut trusted = RootCertStore::empty();
    if config.get_ssl_mode() == SslMode::Require {
        let found = rustls_native_certs::load_native_certs();
        trusted.add_parsable_certificates(found.certs);
        for error in found.errors {
            tracing::warn!(%error, "authorities that the system trusts cannot be read");
        }
    } else {
        config.ssl_mode(SslMode::Disable);
    }
    let tls = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| foreign(error.to_string()))?;
    Ok(MakeRustlsConnect::new(
        tls.with_root_certificates(trusted).with_no_client_auth(),
    ))
}
