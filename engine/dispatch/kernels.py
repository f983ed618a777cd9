"""Insertion of orders into vehicles' sequences, and free rest places, compiled.

Sequences are chains: node N + r stands for vehicle r. Allocates nothing in its rounds but what it is given. Its slow
twin is in tests/naive_dispatch.py.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from engine.compiled import lean
from engine.types import NONE

I32 = NDArray[np.int32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

BARRED = 2**40


@lean
def free_rests(
    near: I32, holder: I32, blocked: U8, is_charger: U8, vehicle: int, chargers_only: bool, out: I32
) -> int:  # fmt: skip
    """The first of the rest places `near` that nobody else holds and nothing blocks, as many as `out` takes; their
    number."""
    n = 0
    for place in near:
        if n == len(out):
            break
        mine = holder[place] == NONE or holder[place] == vehicle
        if mine and blocked[place] == 0 and (is_charger[place] or not chargers_only):
            out[n] = place
            n += 1
    return n


@njit(cache=True, nogil=True)
def insert(link: I64, end: I64, first: I64, after: I32, owner: I32, lasts: I64, order: int, limit: int) -> bool:
    """Put an order where it adds least among the places that keep its vehicle's time within a limit; when there is
    none, where its vehicle is done soonest. False when no vehicle may take it.

    after: (N + R,) next order, -1 at the end · owner: (N,) vehicle, -1 for an order that nobody has · lasts: (R,) time
    of each vehicle.
    """
    n, vehicles = len(end), len(first)
    best, where, who, fits = BARRED, -1, -1, False
    for r in range(vehicles):
        if first[r, order] >= BARRED // 2:
            continue
        before = n + r
        while before >= 0:
            follows = after[before]
            there = first[r, order] if before >= n else link[before, order]
            if follows >= 0:
                gone = first[r, follows] if before >= n else link[before, follows]
                added = there + link[order, follows] - gone
            else:
                added = there + end[order] - (0 if before >= n else end[before])
            now = lasts[r] + added
            if now <= limit:
                if not fits or added < best:
                    best, where, who, fits = added, before, r, True
            elif not fits and now < best:
                best, where, who = now, before, r
            before = follows
    if where < 0:
        return False
    lasts[who] = lasts[who] + best if fits else best
    after[order] = after[where]
    after[where] = order
    owner[order] = who
    return True


@njit(cache=True, nogil=True)
def remove(link: I64, end: I64, first: I64, after: I32, owner: I32, lasts: I64, order: int) -> None:
    """Take an order out of its vehicle's sequence."""
    n = len(end)
    r = owner[order]
    before = n + r
    while after[before] != order:
        before = after[before]
    follows = after[order]
    there = first[r, order] if before >= n else link[before, order]
    if follows >= 0:
        past = first[r, follows] if before >= n else link[before, follows]
        lasts[r] += past - there - link[order, follows]
    else:
        lasts[r] += (0 if before >= n else end[before]) - there - end[order]
    after[before] = follows
    after[order] = -1
    owner[order] = -1


@njit(cache=True, nogil=True)
def next_noise(noise):  # type: ignore[no-untyped-def]
    """The next of a row of 64 random bits (xorshift)."""
    noise ^= noise << np.uint64(13)
    noise ^= noise >> np.uint64(7)
    return noise ^ noise << np.uint64(17)


@njit(cache=True, nogil=True)
def below(noise, count):  # type: ignore[no-untyped-def]
    """A number from 0 to count - 1."""
    return np.int64(noise % np.uint64(count))


@njit(cache=True, nogil=True)
def improve(
    link: I64, end: I64, first: I64, after: I32, owner: I32, lasts: I64, kept: I32, goal: int, rounds: int, most: int
) -> int:
    """Ruin and recreate: orders of the vehicle that is done last and of up to two others are taken out and put in
    again; the result stays when it is done no later (equally soon: with no larger total). Returns the rounds done.

    kept: (2 (N + R) + N,) room · goal: a makespan that can't be beaten · most: orders taken out of one vehicle.
    """
    n, vehicles = len(end), len(first)
    nodes = n + vehicles
    out = np.empty(3 * most, np.int32)
    noise = np.uint64(0x9E3779B97F4A7C15)
    old_time = lasts.copy()
    for done in range(rounds):
        last = 0
        for r in range(vehicles):
            if lasts[r] > lasts[last]:
                last = r
        makespan, total = lasts[last], lasts.sum()
        if makespan <= goal:
            return done
        kept[:nodes] = after
        kept[nodes : nodes + n] = owner
        old_time[:] = lasts
        count = 0
        for k in range(3):
            noise = next_noise(noise)
            r = last
            if k > 0:
                r = below(noise, vehicles)
            length = 0
            at = after[n + r]
            while at >= 0:
                length += 1
                at = after[at]
            if length == 0:
                continue
            take = 1 + below(noise >> np.uint64(20), min(most, length))
            skip = below(noise >> np.uint64(40), length - take + 1)
            at = after[n + r]
            for i in range(skip + take):
                follows = after[at]
                if i >= skip:
                    remove(link, end, first, after, owner, lasts, at)
                    out[count] = at
                    count += 1
                at = follows
        for i in range(count - 1, 0, -1):
            noise = next_noise(noise)
            j = below(noise, i + 1)
            out[i], out[j] = out[j], out[i]
        good = True
        for i in range(count):
            good &= insert(link, end, first, after, owner, lasts, out[i], makespan - 1)
        now = lasts.max()
        if not good or now > makespan or (now == makespan and lasts.sum() > total):
            after[:] = kept[:nodes]
            owner[:] = kept[nodes : nodes + n]
            lasts[:] = old_time
    return rounds
