"""Films: timed gray frames in video files (FFV1, H.264, MJPEG) and HDF5, streamed, with exact gray levels.

Also LED patterns in files for LED drivers.
"""

from heliograph.media.film import ColourFilm, convert_film, create_film, open_colours, open_film
from heliograph.media.reader import FilmReader
from heliograph.media.slots import SlotFile, open_slots
from heliograph.media.writer import FilmWriter

__all__ = [
    "ColourFilm", "FilmReader", "FilmWriter", "SlotFile", "convert_film", "create_film", "open_colours", "open_film",
    "open_slots",
]  # fmt: skip
