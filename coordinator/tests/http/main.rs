//! The HTTP interface over a real connection.

mod clients;
mod support;
mod workers;
