//! The HTTP interface over a real connection.

mod access;
mod clients;
mod connections;
mod steering;
mod support;
mod workers;
