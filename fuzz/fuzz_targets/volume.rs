#![no_main]

use photonfarm_tests::fuzz::target;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| (target("volume").run)(bytes));
