"""Films: timed gray frames in video files (FFV1, H.264, MJPEG) and HDF5, streamed, with exact gray levels."""

from heliograph.media.convert import convert_film
from heliograph.media.film import create_film, open_film
from heliograph.media.reader import FilmReader
from heliograph.media.writer import FilmWriter

__all__ = ["FilmReader", "FilmWriter", "convert_film", "create_film", "open_film"]
