//! Memory allocations per frame after warm-up.

use solaspect::aspect::{Expected, solve};
use solaspect::instrument::builtin;
use solaspect::simulate::{Conditions, RandomScenes, SUN_RADIUS_ARCSEC};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// An allocator that counts per thread, because other tests run in parallel.
struct Counting;

thread_local! {
    static CALLS: Cell<usize> = const { Cell::new(0) };
    static BYTES: Cell<usize> = const { Cell::new(0) };
}

fn count(bytes: usize) {
    CALLS.set(CALLS.get() + 1);
    BYTES.set(BYTES.get() + bytes);
}

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size.saturating_sub(layout.size()));
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `work`; its result, and the number of allocations and bytes requested by this thread.
pub fn counted<T>(work: impl FnOnce() -> T) -> (T, [usize; 2]) {
    let before = [CALLS.get(), BYTES.get()];
    let result = work();
    let after = [CALLS.get(), BYTES.get()];
    (result, [after[0] - before[0], after[1] - before[1]])
}

#[test]
fn a_warm_frame_asks_for_little_memory() {
    let instrument = builtin("demo").unwrap();
    let scenes = RandomScenes::new(&instrument, &Conditions::of(&instrument), 3).unwrap();
    let frame = scenes.scene(1).unwrap().frame().unwrap();
    let expected = Some(Expected {
        radius_arcsec: SUN_RADIUS_ARCSEC,
    });
    let first = solve(&frame, &instrument, expected, None);
    let track = first.track.as_ref();
    solve(&frame, &instrument, expected, track);
    let (_, acquiring) = counted(|| solve(&frame, &instrument, expected, None));
    let (_, tracking) = counted(|| solve(&frame, &instrument, expected, track));
    println!("acquiring: {acquiring:?} calls and bytes, tracking: {tracking:?}");
    // The cutout of the disc, lists of the pixels of limb and marks, and short temporary lists.
    assert!(tracking[0] < 140 && tracking[1] < 1_700_000, "{tracking:?}");
    assert!(
        acquiring[0] < 360 && acquiring[1] < 3_200_000,
        "{acquiring:?}"
    );
}
