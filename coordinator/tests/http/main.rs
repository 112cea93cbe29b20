//! The HTTP interface over a real connection.

mod access;
mod checks;
mod clients;
mod connections;
mod page;
mod steering;
mod support;
mod workers;
