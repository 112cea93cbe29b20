//! Farms of real processes to which things happen: after each fault the picture is that of one process with one
//! thread, the books balance, nothing is left behind, and status and figures say what happened.

mod absence;
mod clock;
mod deliveries;
mod disk;
mod hostile;
mod kills;
mod memory;
mod network;
mod restore;
