"""What the binding costs beside the library: wall time of 1,000 calls over the solver's own time in them.

    python bench.py [CALLS]
"""

import sys
import time

import solaspect

PLACE = (34.49, -104.2218, 38405.0)


def measure(title, calls, frames, instrument, timed, copied=False):
    arrays = [frame.array.copy(order="F") if copied else frame.array for frame in frames]
    own_us = 0
    start = time.perf_counter()
    for call in range(calls):
        told = {"time": frames[call % len(frames)].time, "place": PLACE} if timed else {}
        own_us += solaspect.solve(arrays[call % len(arrays)], instrument=instrument, **told).solve_us
    wall_us = 1e6 * (time.perf_counter() - start)
    print(f"{title}: {wall_us / calls:.0f} us a call, {own_us / calls:.0f} us of them in the solver: {wall_us / own_us:.4f}")


def main(calls=1000):
    instrument = solaspect.Instrument.load("demo")
    for bits in (8, 12):
        frames = solaspect.simulate(frames=20, bits=bits)
        measure(f"{bits} bit", calls, frames, instrument, timed=False)
        measure(f"{bits} bit, with time and place", calls, frames, instrument, timed=True)
        measure(f"{bits} bit, column-major, copied", calls, frames, instrument, timed=False, copied=True)


main(*map(int, sys.argv[1:]))
