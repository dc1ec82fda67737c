import io
import struct

import numpy as np
import pytest
import tifffile

from pipeline.files import tiff


def written(**how) -> bytes:
    file = io.BytesIO()
    with tifffile.TiffWriter(file, byteorder=how.pop("byteorder", "<")) as tif:
        small = np.zeros((8, 8), np.uint8)
        tif.write(small, subifds=1, metadata=None)
        tif.write(np.zeros((64, 64), np.uint16), subfiletype=1, metadata=None, **how)
        tif.write(small, metadata=None, extratags=[(50829, 4, 4, (7, 4, 60, 60), True)])
    return file.getvalue()


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("how", [{"rowsperstrip": 8}, {"tile": (16, 16)}, {}])
def test_all_data_are_found_in_directories_and_below_them(byteorder, how):
    content = written(byteorder=byteorder, **how)
    found = tiff.directories(io.BytesIO(content))
    assert len(found) == 3
    with tifffile.TiffFile(io.BytesIO(content)) as tif:
        pages = [*tif.pages, *tif.pages[0].pages]
        ends = [o + n for p in pages for o, n in zip(p.dataoffsets, p.databytecounts, strict=True)]
    assert tiff.data_end(found) == max(ends)
    assert tiff.active_area(found) == (7, 4)


def test_what_is_no_tiff_or_is_cut_says_nothing():
    content = written()
    (first,) = struct.unpack("<I", content[4:8])
    for other in (b"", b"II*\0", b"\x89PNG\r\n" + bytes(100), content[: first + 30]):
        found = tiff.directories(io.BytesIO(other))
        assert found == []
        assert tiff.data_end(found) is None
        assert tiff.active_area(found) is None


def test_no_more_is_asked_for_than_the_file_holds():
    class Measured(io.BytesIO):
        def read(self, size=-1):
            assert size <= len(self.getbuffer())  # a file's own read makes room for so much
            return super().read(size)

    entry = struct.pack("<HHII", 273, 4, 2**32 - 1, 8)
    claims = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", 1) + entry + bytes(4)
    assert tiff.directories(Measured(claims + bytes(2000))) == []


def test_a_directory_that_leads_to_itself_ends():
    entry = struct.pack("<HHII", 330, 4, 1, 8)
    itself = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", 1) + entry
    assert len(tiff.directories(io.BytesIO(itself + struct.pack("<I", 8)))) == 1
