"""Live running: detections come in line by line, tracks go out, and a killed run goes on where it was.

`follow` reads newline-delimited JSON (or an Arrow IPC stream) from standard input or from a file that grows, makes
scans of it, steps a tracker and writes the confirmed tracks. What it has read, held and written stands in one
checkpoint; docs/live.md says what that promises. `trackrs track --follow` is this function.
"""

from trackrs.live._files import StreamError
from trackrs.live._follow import follow
from trackrs.live._records import Limits, LiveRun

__all__ = ["Limits", "LiveRun", "StreamError", "follow"]
