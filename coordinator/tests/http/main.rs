//! The HTTP interface over a real connection.

mod access;
mod audit;
mod checks;
mod clients;
mod connections;
mod listing;
mod page;
mod steering;
mod support;
mod uploads;
mod webhooks;
mod workers;
