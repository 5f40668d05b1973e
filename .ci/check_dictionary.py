"""Loads the link's dictionary with the ground system of NASA's F Prime, and compares it with the protocol page.

    check_dictionary.py DICTIONARY.json docs/protocol.md
"""

import re
import sys
from pathlib import Path

from fprime_gds.common.loaders.ch_json_loader import ChJsonLoader
from fprime_gds.common.loaders.cmd_json_loader import CmdJsonLoader
from fprime_gds.common.loaders.event_json_loader import EventJsonLoader
from fprime_gds.common.loaders.pkt_json_loader import PktJsonLoader

path, page = sys.argv[1], Path(sys.argv[2]).read_text()
channels = ChJsonLoader(path).get_name_dict(None)
commands = CmdJsonLoader(path).get_name_dict(None)
events = EventJsonLoader(path).get_name_dict(None)
packets = PktJsonLoader(path).get_name_dict(None, "housekeeping", channels)

fields = re.findall(r"^\| \d+ \| `(\w+)` \| ", page, re.M)
assert fields[0] == "layout", fields[:3]
assert [name.removeprefix("solaspect.") for name in (c.get_full_name() for c in packets["housekeeping"].get_ch_list())] == fields[1:]

stated = re.findall(r"^\| 0x([0-9A-F]{4}) \| `(\w+)` \|(.*?)\| (.*?) \| ", page, re.M)
assert len(stated) > 40, stated
for key, name, variables, _ in stated:
    command = commands[f"solaspect.{name}"]
    assert command.get_op_code() == 0x10FF0000 | int(key, 16), name
    written = [variable.split(" (")[0] for variable in variables.strip().split("; ") if variable]
    assert [argument[0] for argument in command.get_args()] == written, (name, written)

for name in ("tracking_on", "solution", "error", "exposure_start", "propagated", "moon_found", "receipt", "frame_marks", "result"):
    event = events[f"solaspect.{name}"]
    kinds = [argument[2]() for argument in event.get_args()]
    assert kinds or name == "tracking_on", name

# The enum of a channel has its names.
quality = channels["solaspect.quality"].get_type_obj()()
quality.val = "fine"
assert quality.numeric_value == 2
print(f"{len(channels)} channels, {len(commands)} commands, {len(events)} events")
