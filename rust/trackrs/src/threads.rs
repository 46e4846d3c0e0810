//! Work in parts on several threads: each takes the next part when it is done with one, so that a thread that the system
//! holds up delays no other.

use std::panic::resume_unwind;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Parts of a piece of work for each thread.
pub(crate) const PARTS: usize = 8;

/// Does the parts on so many threads, of which this is one. After an error no further part is begun; of several errors it is
/// that of the first part, on any number of threads.
pub(crate) fn share_out<P: Send, E: Send>(
    parts: impl Iterator<Item = P> + Send,
    threads: usize,
    work: impl Fn(P) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let parts = Mutex::new(parts.enumerate());
    let failed: Mutex<Option<(usize, E)>> = Mutex::new(None);
    let some = || {
        while lock(&failed).is_none() {
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
    use std::convert::Infallible;

    use super::*;

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
}
