"""Make the README's moving picture out of what `make demo` wrote.

python docs/make_picture.py out/demo/occlusion-ardupilot/flight.mp4
"""

import sys
from pathlib import Path

import av
from PIL import Image

FIRST, LAST, STEP = 400, 560, 4  # 20 to 28 s: the first viaduct
SIZE_WH = (672, 324)

with av.open(sys.argv[1]) as container:
    frames = [frame.to_image() for frame in container.decode(video=0)]
shown = [frame.resize(SIZE_WH, Image.Resampling.LANCZOS) for frame in frames[FIRST:LAST:STEP]]
target = Path(__file__).with_name("flight.webp")
shown[0].save(target, save_all=True, append_images=shown[1:], duration=200, loop=0, quality=35, method=6)
print(f"wrote {target}, {target.stat().st_size} bytes")
