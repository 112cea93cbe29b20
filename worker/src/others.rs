//! Whether somebody else uses this machine: how busy processes other than this one keep its processors.

use std::time::Duration;

/// Share of the processors that others may use, unless it is told otherwise \[percent\].
pub const OTHERS_PERCENT: &str = "10";
/// Time between two looks.
pub(crate) const LOOK: Duration = Duration::from_secs(5);
/// Looks in a row that must show others at work before they count: a short command is nobody who works here.
const BUSY_LOOKS: u32 = 3;
/// Looks in a row that must show none before they are gone: whoever reads does not type.
const QUIET_LOOKS: u32 = 24;

/// Times of the kernel since the start of the machine \[ticks\].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Ticks {
    /// Of all processors, idle or not.
    all: u64,
    /// In which they were at work: for users, at low priority, for the system, for interrupts.
    busy: u64,
    /// In which they were at work for this process.
    own: u64,
}

impl Ticks {
    /// As `/proc/stat` and `/proc/self/stat` say, if they can be read.
    pub(crate) fn now() -> Option<Self> {
        let read = |path| std::fs::read_to_string(path).ok();
        Self::parsed(&read("/proc/stat")?, &read("/proc/self/stat")?)
    }

    fn parsed(machine: &str, process: &str) -> Option<Self> {
        let numbers =
            |text: &str| -> Vec<u64> { text.split_whitespace().map_while(|word| word.parse().ok()).collect() };
        // User, nice, system, idle, waiting for disks, interrupts (two kinds), taken by other machines of the host.
        let times = numbers(machine.lines().next()?.strip_prefix("cpu ")?);
        let all = times.get(..8)?.iter().sum();
        let busy = [0, 1, 2, 5, 6].iter().map(|index| times[*index]).sum();
        // The name of the program, in parentheses, may hold anything. The state and ten numbers come before the times.
        let (_, rest) = process.rsplit_once(')')?;
        let mut own = rest.split_whitespace().skip(11).map(|word| word.parse::<u64>().ok());
        let own = own.next()?? + own.next()??;
        Some(Self { all, busy, own })
    }

    /// Of a machine of which others had so many of each hundred ticks that each look takes.
    #[cfg(test)]
    pub(crate) fn of_others(busy: u64) -> Self {
        Self {
            all: 2 * busy,
            busy,
            own: 0,
        }
    }

    /// Share of the processors that others had since `before` \[percent\].
    fn others_since(&self, before: &Self) -> f64 {
        let all = self.all.saturating_sub(before.all);
        let busy = self.busy.saturating_sub(before.busy);
        let own = self.own.saturating_sub(before.own);
        100.0 * busy.saturating_sub(own) as f64 / all.max(1) as f64
    }
}

/// Whether others are at work, as far as looks have shown.
#[derive(Clone, Debug)]
pub(crate) struct Others {
    most_percent: f64,
    before: Option<Ticks>,
    are_here: bool,
    /// Looks in a row that showed otherwise.
    against: u32,
}

impl Others {
    /// Others count who use more than such a share of the processors \[percent\].
    pub(crate) fn beyond(most_percent: f64) -> Self {
        Self {
            most_percent,
            before: None,
            are_here: false,
            against: 0,
        }
    }

    /// Looks, and says whether others are at work.
    pub(crate) fn look(&mut self, now: Ticks) -> bool {
        if let Some(before) = self.before.replace(now) {
            let seen = now.others_since(&before) > self.most_percent;
            self.against = if seen == self.are_here { 0 } else { self.against + 1 };
            let needed = if self.are_here { QUIET_LOOKS } else { BUSY_LOOKS };
            if self.against == needed {
                (self.are_here, self.against) = (seen, 0);
            }
        }
        self.are_here
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_times_are_read() {
        let machine = "cpu  100 20 30 400 50 6 7 8 90 10\ncpu0 1 2 3\nintr 5\n";
        let process = "42 (a) b (c)) S 1 42 42 0 -1 4194304 11 12 13 14 60 15 1 2 20 0 9 0 100 1000 10\n";
        let expected = Ticks {
            all: 621,
            busy: 163,
            own: 75,
        };
        assert_eq!(Ticks::parsed(machine, process), Some(expected));
        assert_eq!(Ticks::parsed("cpu  1 2\n", process), None);
        assert_eq!(Ticks::parsed(machine, "42 (a) S 1"), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_machine_tells_its_times() {
        let first = Ticks::now().unwrap();
        let later = Ticks::now().unwrap();
        assert!(first.all > 0 && later.all >= first.all && later.own >= first.own);
    }

    #[test]
    fn others_come_after_some_looks_and_go_after_many() {
        let mut others = Others::beyond(10.0);
        let mut ticks = Ticks {
            all: 0,
            busy: 0,
            own: 0,
        };
        // Of a hundred ticks, some go to others and some to this process.
        let mut look = |foreign: u64, own: u64| {
            ticks = Ticks {
                all: ticks.all + 100,
                busy: ticks.busy + foreign + own,
                own: ticks.own + own,
            };
            others.look(ticks)
        };
        assert!(!look(90, 0), "nothing is known of the time before the first look");
        assert!((0..50).all(|_| !look(10, 90)), "its own work is not that of others");
        assert_eq!([(); 3].map(|()| look(11, 80)), [false, false, true]);
        assert!((0..23).all(|_| look(10, 0)));
        assert!(look(50, 0), "they are here again");
        assert!((0..23).all(|_| look(0, 0)));
        assert!(!look(0, 0));
        assert_eq!([look(50, 0), look(50, 0), look(0, 0), look(50, 0)], [false; 4]);
    }
}
