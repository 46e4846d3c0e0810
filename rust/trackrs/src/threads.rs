//! Work in parts on several threads: each takes the next part when it is done with one, so that a thread that the system
//! holds up delays no other.

use std::convert::Infallible;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::{available_parallelism, panicking};

/// Parts of a piece of work for each thread.
pub(crate) const PARTS: usize = 8;

/// Points of a part of a partition's work, on any number of threads: some milliseconds.
pub(crate) const POINTS: usize = 1024;

/// Fewer points than this are not worth a thread of their own.
const POINTS_PER_THREAD: usize = 4 * POINTS;

/// On how many threads a partition looks at so many points.
pub(crate) fn for_points(count: usize) -> usize {
    static PROCESSORS: OnceLock<usize> = OnceLock::new();
    let most = count / POINTS_PER_THREAD;
    if most <= 1 {
        return 1;
    }
    most.min(*PROCESSORS.get_or_init(|| available_parallelism().map_or(1, usize::from)))
}

/// What `of` says of every point, on several threads where that pays.
pub(crate) fn each_point<T: Send + Clone>(count: usize, none: T, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let mut out = vec![none; count];
    let Ok(()) = share_out(out.chunks_mut(POINTS).enumerate(), for_points(count), |(part, out)| {
        for (at, to) in (part * POINTS..).zip(out) {
            *to = of(at);
        }
        Ok::<_, Infallible>(())
    });
    out
}

/// Says so when its thread unwinds.
struct Unwinding<'a>(&'a AtomicBool);

impl Drop for Unwinding<'_> {
    fn drop(&mut self) {
        if panicking() {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

/// Does the parts on so many threads, of which this is one. After an error no further part is begun, nor after a panic or an
/// interrupt, which this thread looks for; of several errors it is that of the first part, on any number of threads.
pub(crate) fn share_out<P: Send, E: Send>(
    parts: impl Iterator<Item = P> + Send,
    threads: usize,
    work: impl Fn(P) -> Result<(), E> + Sync,
) -> Result<(), E> {
    if threads <= 1 {
        let mut parts = parts;
        return parts.try_for_each(work);
    }
    let parts = Mutex::new(parts.enumerate());
    let ended = AtomicBool::new(false);
    let failed: Mutex<Option<(usize, E)>> = Mutex::new(None);
    let some = || {
        let _unwinding = Unwinding(&ended);
        while !ended.load(Ordering::Relaxed) && lock(&failed).is_none() {
            // Parts are taken in their order: when one fails, all before it are done or being done.
            let next = lock(&parts).next();
            let Some((number, part)) = next else { return };
            if let Err(error) = work(part) {
                let mut first = lock(&failed);
                if first.as_ref().is_none_or(|(other, _)| number < *other) {
                    *first = Some((number, error));
                }
            }
        }
    };
    std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(some)).collect();
        some();
        for other in others {
            other.join().unwrap_or_else(|panic| resume_unwind(panic));
        }
    });
    match failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::interrupt;

    #[test]
    fn every_part_is_done_once_on_any_number_of_threads() {
        for threads in [1, 2, 5] {
            for count in [0, 1, 4, 1000] {
                let mut done = vec![0; count];
                let Ok(()) = share_out(done.iter_mut(), threads, |part| {
                    *part += 1;
                    Ok::<_, Infallible>(())
                });
                assert_eq!(done, vec![1; count]);
            }
        }
    }

    #[test]
    fn the_error_is_that_of_the_first_part_that_has_one() {
        for threads in [1, 2, 5] {
            for _ in 0..50 {
                let of = |part: usize| {
                    if part >= 40 && part.is_multiple_of(7) {
                        Err(part)
                    } else {
                        Ok(())
                    }
                };
                assert_eq!(share_out(0..1000, threads, of), Err(42));
            }
        }
    }

    #[test]
    fn a_panic_keeps_its_words() {
        for threads in [1, 3] {
            let done = std::panic::catch_unwind(|| {
                share_out(0..9, threads, |part| -> Result<(), ()> { panic!("part {part}") })
            });
            let panic = done.unwrap_err();
            assert!(
                panic
                    .downcast_ref::<String>()
                    .is_some_and(|words| words.contains("part"))
            );
        }
    }

    #[test]
    fn points_are_asked_in_parts_and_stand_in_their_order() {
        for count in [0, 1, POINTS, 20 * POINTS + 5] {
            assert_eq!(
                each_point(count, 0, |at| 3 * at),
                (0..count).map(|at| 3 * at).collect::<Vec<_>>()
            );
        }
    }

    #[test]
    fn an_interrupt_ends_the_other_threads_too() {
        let begun = std::sync::atomic::AtomicUsize::new(0);
        let ended = interrupt::until(
            || false,
            || {
                let Ok(()) = share_out(0..1_000_000, 3, |_| {
                    begun.fetch_add(1, Ordering::Relaxed);
                    interrupt::ahead(1 << 12);
                    std::thread::sleep(std::time::Duration::from_micros(100));
                    Ok::<_, Infallible>(())
                });
                Ok(())
            },
        );
        assert!(matches!(ended, Err(Error::Interrupted)));
        assert!(begun.into_inner() < 500_000);
    }
}
