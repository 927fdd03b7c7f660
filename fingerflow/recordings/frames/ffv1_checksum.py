"""Verification of FFV1 video packets by the checksums in the packets.

FFmpeg detects a wrong checksum, but only logs it and fills the slice with old pixels.

Source: RFC 9043, sections 4.4 (slices and their footers) and 4.9.3 (slice_crc_parity): a packet is a row of slices,
each with a footer of its size in 3 bytes, a byte of status and a CRC that makes the CRC of the whole slice 0. The
polynomial is that of CRC-32 with the highest bit first: zlib's, with the bits of its input and result reversed.
"""

import zlib

_FOOTER = 8
_REVERSED = bytes(int(f"{value:08b}"[::-1], 2) for value in range(256))
_ONES = 0xFFFFFFFF


def slices_are_whole(packet: bytes) -> bool:
    """Return whether all slice checksums of an FFV1 packet are correct; False for a packet without checksums."""
    end = len(packet)
    while end > _FOOTER:
        size = int.from_bytes(packet[end - _FOOTER : end - _FOOTER + 3], "big") + _FOOTER
        begin = end - size
        # The CRC of FFV1 starts at 0 and is 0 for a valid slice; zlib inverts it at the start and at the end.
        if begin < 0 or zlib.crc32(packet[begin:end].translate(_REVERSED), _ONES) != _ONES:
            return False
        end = begin
    return end == 0 and len(packet) > 0
