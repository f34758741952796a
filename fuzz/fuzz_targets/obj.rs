#![no_main]

libfuzzer_sys::fuzz_target!(init: kiln_fuzz::pass_caught_panics(), |bytes: &[u8]| kiln_fuzz::obj(bytes));
