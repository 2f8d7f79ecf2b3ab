"""Frames of a log by name. Usage: decode_frames.py LOG"""

import sys
from collections import Counter

from yieldmon import api

codec, count = api.Codec(), Counter[str]()
for message in api.read_log(sys.argv[1]):
    frame = codec.decode(message)
    if frame is None:
        count["frames of others"] += 1
        continue
    if not count[frame.message]:
        print(f"{frame.time_s:.3f} {frame.message}: {', '.join(f'{name} {value}' for name, value in frame.signals.items())}")
    count[frame.message] += 1
print(dict(count))
