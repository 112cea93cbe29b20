//! The HTTP interface over a real connection.

mod access;
mod clients;
mod connections;
mod support;
mod workers;
