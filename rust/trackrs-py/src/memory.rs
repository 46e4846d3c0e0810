//! Large pieces of memory stand in large pages, as those of NumPy's own arrays do.
//!
//! A result is written once. Of a small page's worth of it more time goes to asking the system for the page than to
//! writing it, and threads that write ask one after the other.

use std::alloc::{GlobalAlloc, Layout, System};

/// From so many bytes on; NumPy's bound.
#[cfg(target_os = "linux")]
const LARGE: usize = 1 << 22;

/// The system's allocator, with that advice to the system.
pub(crate) struct LargePages;

// SAFETY: every call is the system's allocator's own; `advise` changes nothing that a program can see.
unsafe impl GlobalAlloc for LargePages {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises are those asked for.
        advise(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        advise(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as above.
        advise(unsafe { System.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Asks for large pages from the first whole page on.
#[cfg(target_os = "linux")]
fn advise(memory: *mut u8, size: usize) -> *mut u8 {
    const PAGE: usize = 4096;
    if size >= LARGE && !memory.is_null() {
        let before = memory.align_offset(PAGE);
        // SAFETY: the range lies within the piece. It is advice: what is in the memory stays, and a system without large pages
        // refuses, which does not matter.
        unsafe {
            libc::madvise(memory.wrapping_add(before).cast(), size - before, libc::MADV_HUGEPAGE);
        }
    }
    memory
}

#[cfg(not(target_os = "linux"))]
fn advise(memory: *mut u8, _size: usize) -> *mut u8 {
    memory
}
