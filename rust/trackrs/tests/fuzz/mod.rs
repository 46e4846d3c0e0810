//! Every public numeric entry against numbers that no sensor should send, and saved states against bytes that nobody saved.
//!
//! A case is a string of bytes, from which an entry draws its arguments ([`source::Source`]). Nothing may panic, an error is a
//! typed one, and no number that is not finite may come out as a result. Here the bytes are random ones, [`CASES`] for each
//! entry, or as many as `TRACKRS_FUZZ_CASES` says (`100..200` for those of these numbers); `rust/fuzz` has the same entries
//! for a fuzzer that follows the coverage.

mod association;
mod filters;
mod partitions;
mod places;
mod scores;
mod source;
mod states;
mod trackers;

pub(crate) use source::Source;

/// What is done with a case.
pub(crate) type Entry = fn(&mut Source<'_>);

macro_rules! entries {
    ($($module:ident :: $name:ident),* $(,)?) => {
        /// All of them by their names.
        pub(crate) const ENTRIES: &[(&str, Entry)] = &[$((stringify!($name), $module::$name)),*];

        #[cfg(test)]
        mod random_bytes {
            $(#[test]
            fn $name() {
                super::random(stringify!($name));
            })*
        }
    };
}

entries!(
    association::assignment,
    association::ranked_assignments,
    association::joint_marginals,
    association::joint_existences,
    association::gates,
    filters::run_and_smooth,
    filters::adaptive_run,
    filters::one_step,
    filters::batch,
    filters::ranges,
    filters::fusion,
    filters::mixture_moments,
    filters::starts,
    filters::screen,
    partitions::partitions,
    partitions::outlier_factors,
    partitions::spanning_trees,
    places::geodetic,
    places::local_frames,
    places::similarities,
    places::placements,
    places::rotations,
    places::closed_forms,
    scores::ospa_and_gospa,
    scores::gospa_of_ellipses,
    scores::evaluation,
    scores::consistency,
    scores::innovations,
    scores::chi_squares,
    scores::clocks,
    states::bytes_of_trackers,
    states::bytes_of_mixtures,
    trackers::multi_target,
    trackers::intensity,
);

/// Cases of each entry in the ordinary tests.
#[cfg(test)]
const CASES: u64 = 100_000;

#[cfg(test)]
fn wanted() -> std::ops::Range<u64> {
    let Ok(text) = std::env::var("TRACKRS_FUZZ_CASES") else {
        return 0..CASES;
    };
    let number = |text: &str| {
        text.parse()
            .expect("TRACKRS_FUZZ_CASES is a count or a range such as 100..200")
    };
    match text.split_once("..") {
        Some((from, to)) => number(from)..number(to),
        None => 0..number(&text),
    }
}

#[cfg(test)]
fn random(name: &str) {
    use rand::{Rng, SeedableRng};
    let (_, entry) = ENTRIES.iter().find(|entry| entry.0 == name).expect("an entry");
    let mut bytes = [0; 768];
    for case in wanted() {
        let hash = |hash: u64, byte: u8| hash.wrapping_mul(0x0100_0000_01b3) ^ u64::from(byte);
        rand_pcg::Pcg64Mcg::seed_from_u64(name.bytes().fold(case, hash)).fill_bytes(&mut bytes);
        let run = std::panic::AssertUnwindSafe(|| entry(&mut Source::new(&bytes)));
        assert!(std::panic::catch_unwind(run).is_ok(), "{name}: case {case}");
    }
}
