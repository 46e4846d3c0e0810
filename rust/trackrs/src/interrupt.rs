//! Whether a long call shall go on.
//!
//! A partition, an assignment or a score of a million points takes seconds in one call. Their loops say how much they are
//! about to do (`ahead`); at most every 30 ms the caller of [`until`] is asked whether to go on, and if not, the
//! call ends with [`Error::Interrupted`].
//!
//! It ends by unwinding, as if it had panicked, but with no message, and only in a thread that is inside `until`: so the
//! functions on the way, which compute values out of values and hold nothing that could be left half done, need not know of
//! it, and results are the same bits with and without. A program compiled with `panic = "abort"` must not use `until`; what
//! changes something in its place (a tracker) must be thrown away after an interrupt, or not be run under it.

use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::time::{Duration, Instant};

use crate::error::{Error, Result};

/// How long the caller is not asked.
const PATIENCE: Duration = Duration::from_millis(30);

/// The clock is looked at after so many operations, about a tenth of a millisecond.
const STRIDE: usize = 1 << 17;

struct Watch {
    go_on: Box<dyn FnMut() -> bool>,
    asked: Instant,
}

thread_local! {
    /// Operations until the clock is looked at; without a watch, of which this thread has none, those of centuries.
    static LEFT: Cell<usize> = const { Cell::new(usize::MAX) };
    static WATCH: RefCell<Option<Watch>> = const { RefCell::new(None) };
}

/// What is thrown.
struct Interrupted;

/// Does `work` as long as `go_on` says so, which is asked every 30 ms or so in the same thread.
///
/// # Errors
/// [`Error::Interrupted`], and those of `work`.
///
/// ```
/// use trackrs::partition::{Partitioner, Points, kmeans::KMeansPartition};
/// let (points, two) = (Points::new(&[0.0, 1.0, 8.0, 9.0], 1)?, KMeansPartition { lower: 2, upper: 2, seed: 0 });
/// let begun = std::time::Instant::now();
/// let labels = trackrs::interrupt::until(move || begun.elapsed().as_secs() < 1, || two.labels(&points))?;
/// assert_eq!(labels[0], labels[1]);
/// # Ok::<(), trackrs::Error>(())
/// ```
pub fn until<T>(go_on: impl FnMut() -> bool + 'static, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let watch = Watch {
        go_on: Box::new(go_on),
        asked: Instant::now(),
    };
    let before = (WATCH.replace(Some(watch)), LEFT.replace(STRIDE));
    let done = catch_unwind(AssertUnwindSafe(work));
    WATCH.set(before.0);
    LEFT.set(before.1);
    match done {
        Ok(result) => result,
        Err(thrown) if thrown.is::<Interrupted>() => Err(Error::Interrupted),
        Err(panic) => resume_unwind(panic),
    }
}

/// So many operations are ahead, each about a nanosecond; more than there are do no harm.
#[inline]
pub(crate) fn ahead(operations: usize) {
    match LEFT.get().checked_sub(operations) {
        Some(left) => LEFT.set(left),
        None => look(),
    }
}

#[cold]
#[inline(never)]
fn look() {
    // Out of its place, as what is asked may itself come here.
    let Some(mut watch) = WATCH.take() else {
        LEFT.set(usize::MAX);
        return;
    };
    LEFT.set(usize::MAX);
    let go_on = watch.asked.elapsed() < PATIENCE || {
        let go_on = (watch.go_on)();
        watch.asked = Instant::now();
        go_on
    };
    WATCH.set(Some(watch));
    LEFT.set(STRIDE);
    if !go_on {
        resume_unwind(Box::new(Interrupted));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn endless() -> Result<()> {
        loop {
            ahead(1000);
        }
    }

    #[test]
    fn work_ends_when_the_caller_says_so() {
        let mut asked = 0;
        let go_on = move || {
            asked += 1;
            asked < 3
        };
        let begun = Instant::now();
        assert!(matches!(until(go_on, endless), Err(Error::Interrupted)));
        assert!(begun.elapsed() >= 3 * PATIENCE);
    }

    #[test]
    fn work_that_ends_by_itself_has_its_own_result() {
        assert_eq!(until(|| false, || Ok(7)).ok(), Some(7));
        let refused = until(|| false, || Err::<(), _>(Error::invalid("k", 0, "must be at least 1")));
        assert!(matches!(refused, Err(Error::InvalidParameter { .. })));
        assert!(catch_unwind(|| until(|| false, || -> Result<()> { panic!("on purpose") })).is_err());
    }

    #[test]
    fn each_has_its_own_patience() {
        let ended = until(
            || true,
            || {
                assert!(matches!(until(|| false, endless), Err(Error::Interrupted)));
                ahead(1 << 20);
                // What is asked may compute, and be interrupted, itself.
                let asking = || until(|| false, endless).is_ok();
                assert!(matches!(until(asking, endless), Err(Error::Interrupted)));
                Ok(())
            },
        );
        assert!(ended.is_ok());
        // Nobody is asked any more.
        (0..100).for_each(|_| ahead(usize::MAX / 2));
    }
}
