"""Measures the overhead of the binding: wall time of 1,000 calls, divided by the solver's own time in them.

    python bench.py [CALLS]
"""

import sys
import time

import numpy as np
import solaspect

PLACE = (34.49, -104.2218, 38405.0)


def measure(title, calls, frames, arrays, with_time=False, **arguments):
    own_us = 0
    start = time.perf_counter()
    for call in range(calls):
        number = call % len(frames)
        if with_time:
            arguments["time"] = frames[number].time
        own_us += solaspect.solve(arrays[number], **arguments).solve_us
    wall_us = 1e6 * (time.perf_counter() - start)
    print(f"{title}: {wall_us / calls:.0f} us a call, {own_us / calls:.0f} us of them in the solver: {wall_us / own_us:.3f}")


def main(calls=1000):
    instrument = solaspect.Instrument.load("demo")
    for bits in (8, 12):
        frames = solaspect.simulate(frames=20, bits=bits)
        arrays = [frame.array for frame in frames]
        arguments = {"instrument": instrument, "saturation_dn": frames[0].saturation_dn}
        measure(f"{bits} bit", calls, frames, arrays, **arguments)
        measure(f"{bits} bit, with time and place", calls, frames, arrays, with_time=True, place=PLACE, **arguments)
        measure(f"{bits} bit, saturation_dn not given", calls, frames, arrays, instrument=instrument)
        measure(f"{bits} bit, columns first, copied", calls, frames, [np.asfortranarray(array) for array in arrays], **arguments)


main(*map(int, sys.argv[1:]))
