//! Bandwidth schedules.
