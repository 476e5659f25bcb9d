"""The counter-based random numbers: ChaCha with 8 rounds (Bernstein 2008), 64-bit counter and 64-bit nonce."""

import struct

MASK = 0xFFFFFFFF
CONSTANTS = struct.unpack("<4I", b"expand 32-byte k")
TAG = 0x74726773        # "trgs"


def rotate(x, n):
    return ((x << n) | (x >> (32 - n))) & MASK


def quarter_round(s, a, b, c, d):
    for x, y, z, n in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
        s[x] = (s[x] + s[y]) & MASK
        s[z] = rotate(s[z] ^ s[x], n)


def block(key, counter, nonce, rounds=8):
    """16 words of the stream; `key` is 32 bytes."""
    start = [*CONSTANTS, *struct.unpack("<8I", key), counter & MASK, counter >> 32, nonce & MASK, nonce >> 32]
    s = list(start)
    for _ in range(rounds // 2):
        for column in range(4):
            quarter_round(s, column, 4 + column, 8 + column, 12 + column)
        for diagonal in range(4):
            quarter_round(s, diagonal, 4 + (diagonal + 1) % 4, 8 + (diagonal + 2) % 4, 12 + (diagonal + 3) % 4)
    return [(x + y) & MASK for x, y in zip(s, start)]


def word(seed, purpose, step, id, index):
    """The 32-bit word number `index` of the stream with this address."""
    key = struct.pack("<4Q", seed, purpose, step, TAG)
    return block(key, index // 16, id)[index % 16]


def uniform(seed, purpose, step, id, index):
    """Number `index` in [0, 1): the upper 53 bits of two words, the first one low."""
    low, high = (word(seed, purpose, step, id, 2 * index + k) for k in (0, 1))
    return ((high << 32 | low) >> 11) * 2.0**-53


# RFC 8439, 2.3.2, which puts a 32-bit counter before a 96-bit nonce: the same 128 bits.
assert block(bytes(range(32)), 1 | 0x09000000 << 32, 0x4A000000, 20)[:3] == [0xE4E7F110, 0x15593BD1, 0x1FDD0F50]
# The well-known first words of ChaCha8 for a key and nonce of zeros.
assert struct.pack("<2I", *block(bytes(32), 0, 0)[:2]) == bytes.fromhex("3e00ef2f895f40d6")
