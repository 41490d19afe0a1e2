"""The loop over samples, compiled once for all drives; it calls the code of one by address.

`loading.loops` gives it.
"""

from math import floor
from typing import Any

from numba import njit

from dmptm_ctrl.simulate.elementary import INNER, OPTIONS, borrowed, called_at, wide

LANES = 16  # drives beside each other; `loading.loops` writes another number here
_inline = njit(**OPTIONS, **INNER)
_CALLED: dict[str, Any] = {**OPTIONS, "forceinline": False, "no_cfunc_wrapper": True}
_loop = njit(cache=True, **_CALLED)


@_inline
def held(u, row, i, before):
    """Sample i of a signal held from each sample to the next; `u` may be a ring of the last."""
    size = u.shape[1]
    return before[row] if i < 0 else u[row, i if i < size else i % size]


@_inline
def held_average(u, row, start, end, before):
    """Mean of such a signal between two times in samples; `before` is what it was earlier."""
    first = floor(start)
    last = floor(end)
    if last == first or end == last:
        return held(u, row, first, before)
    total = 0.0
    for i in range(first, last + 1):
        width = min(end, i + 1.0) - max(start, float(i))
        total += width * held(u, row, i, before)
    return total / (end - start)


@_inline
def read_late(ring, row, step, lag):
    """What stood in a row of a ring a `lag` of so many steps ago."""
    back = int(lag)
    newer = ring[row, (step - back) % ring.shape[1]]
    older = ring[row, (step - back - 1) % ring.shape[1]]
    return newer + (lag - back) * (older - newer)


@_inline
def observed(i, y, watched, measured, gains, shown, leak, lead, moves):
    """Let readings show how runs drift, and write what moves coordinates and speeds.

    See `observer`; `lead` is what the coordinates are ahead of the run that is shown. The last
    axis of all but `measured` is that of the runs, the first of `measured`.
    """
    count, runs, own = moves.shape[0] // 2, moves.shape[1], measured.shape[0] - 1
    for k in range(watched.size):
        for s in range(shown.shape[0]):
            for run in range(runs):
                y[s, run] -= shown[s, k, run] * lead[k, run]
    moves[:] = 0.0
    for k in range(watched.size):
        for run in range(runs):
            miss = measured[min(run, own), k, i] - y[watched[k], run]
            for g in range(count):
                moves[g, run] += gains[g, k, run] * (miss - lead[k, run])
                moves[count + g, run] += gains[count + g, k, run] * miss
            lead[k, run] = (1.0 - leak[k]) * miss


@_loop
def march(
    advance, drive, x, count, signals, stride, late, latest, kept, sensors, y, seen, again,
    u, first, before, dead, push, given, given_q, given_v,
    ring, delays, late_of, late_ratio, step0,
    begin, dt, substeps, control, rule, memory, target, noise, closed, command,
    watched, measured, gains, shown, leak, lead, moves, out,
):  # fmt: skip
    """Run one drive over the samples of `out`; see `run.advance`.

    Its code `advance`, see `scalar.source`, is given the table `drive` of arrays. Of these are: the
    state `x` of so many coordinates; `signals`, torques and given motion of substeps, rows a
    `stride` apart or one for all; readings of `late` sensors and the `latest` of each step, `kept`
    a step or none; what is seen, `y` and as one column `seen`. Of late sensors, `late_of` are the
    numbers of the state that they see. With `again`, what is seen is not what was seen behind the
    last step. `u` has the signals of this run from `first` on; `dead` times are in samples.
    """
    drive, x, signals, late = borrowed(drive), borrowed(x), borrowed(signals), borrowed(late)
    latest, seen, ring = borrowed(latest), borrowed(seen), borrowed(ring)
    rule, memory, y, command = borrowed(rule), borrowed(memory), borrowed(y), borrowed(command)
    watched, measured, gains = borrowed(watched), borrowed(measured), borrowed(gains)
    shown, leak, lead, moves = borrowed(shown), borrowed(leak), borrowed(lead), borrowed(moves)
    h = dt / substeps
    inputs, lates, done = dead.size, delays.size, step0
    most = min(y.size, out.shape[1])  # behind these columns are those of the state
    links = max(most - sensors, 0)
    for i in range(out.shape[0]):
        t = begin + i * dt
        at = first + i
        if again or i == 0:
            for n in range(given.size):
                x[given[n]], x[count + given[n]] = given_q[n, i], given_v[n, i]
            for n in range(lates):
                late[n] = late_ratio[n] * x[late_of[n]]
                if delays[n] > 0.0:
                    late[n] = read_late(ring, n, done, delays[n] / h)
            called_at(advance, (drive, stride, kept, 0, links, t, h, t))
        if closed:
            added = noise[i] if noise.size > 0 else 0.0
            called_at(control, (i, t, dt, target[i], added, y, rule, memory, command))
            for j in range(inputs):
                u[j, at] = command[j]
        for c in range(most):
            out[i, c] = y[c]
        for c in range(most, out.shape[1]):
            out[i, c] = x[c - most]
        if watched.size > 0:
            observed(i, seen, watched, measured, gains, shown, leak, lead, moves)
            for g in range(count):
                x[g] += moves[g, 0]
                kick = moves[count + g, 0] if x[count + g] != 0.0 else 0.0
                x[count + g] += kick
                x[2 * count + g] += kick
            for n in range(lates):
                if late_of[n] < count:
                    for back in range(ring.shape[1]):
                        ring[n, back] += late_ratio[n] * moves[late_of[n], 0]
            for c in range(sensors):
                out[i, c] = y[c]
        for k in range(substeps if stride > 0 else 1):
            row = k * stride
            for j in range(inputs):
                signals[row + j] = u[j, at]
            if push.shape[0] > 0:
                for g in range(count):
                    signals[row + inputs + g] = push[i, g]
            if stride > 0:
                for j in range(inputs):
                    if dead[j] > 0.0:
                        start, end = at + k / substeps - dead[j], at + (k + 1) / substeps - dead[j]
                        signals[row + j] = held_average(u, j, start, end, before)
                part, after = (k + 0.5) / substeps, min(i + 1, out.shape[0] - 1)
                for n in range(given.size):
                    place = row + inputs + count + 2 * given[n]
                    signals[place] = given_q[n, i] + part * (given_q[n, after] - given_q[n, i])
                    signals[place + 1] = given_v[n, i] + part * (given_v[n, after] - given_v[n, i])
        called_at(advance, (drive, stride, kept, substeps, links, t, h, begin + (i + 1) * dt))
        own = 0
        for _ in range(substeps if kept > 0 else 0):
            done += 1
            for n in range(lates):
                ring[n, done % ring.shape[1]] = latest[own + n]
            own += lates


@_inline
def some(w, row):
    """Whether a row has a positive number."""
    found = 0
    for lane in range(LANES):
        found |= w[row, lane] > 0.0
    return found > 0


@_loop
def march_lanes(
    w, lanes, calls, when, steps, count, inputs, u_row, anew, reading, seen,
    u, kept, before, dead, late_inputs, ring, delays, late_of, late_ratio, begin, dt, substeps,
    control, rules, memory, target, noise, closed, y, command,
    watched, measured, gains, shown, leak, lead, moves,
    columns, every, out, statistics, samples,
):  # fmt: skip
    """Run drives beside each other over so many samples; see `many.run_many`.

    Rows of `w` are what drives have, so many `lanes` of them: first the state of `count`
    coordinates, from `u_row` on signals as steps take them, which they change or not (`anew`).
    From `reading` on are the rows that are seen: readings first, signals as given last. Before
    them are late readings, behind them the least, greatest, sums and sums of squares of the seen.
    `calls` are addresses of loops over lanes, first the `steps` of a step, then those of what is
    seen; `when` the row of which one number has to be positive for that, or -1. Late sensors see
    the rows `late_of`.
    """
    wide()
    w, calls, when, kept = borrowed(w), borrowed(calls), borrowed(when), borrowed(kept)
    ring, rules, memory = borrowed(ring), borrowed(rules), borrowed(memory)
    y, command, moves = borrowed(y), borrowed(command), borrowed(moves)
    measured, gains = borrowed(measured), borrowed(gains)
    watched, shown, leak, lead = borrowed(watched), borrowed(shown), borrowed(leak), borrowed(lead)
    sensors, lates, done, row = y.size, late_of.size, 0, 0
    late_row, low = reading - lates, reading + seen
    signal = low - inputs
    read = w[reading : reading + sensors]
    size = seen * LANES
    found = w[reading : reading + 5 * seen].reshape((5, size))  # what is seen, least, and so on
    h = dt / substeps
    room = kept.shape[2]
    for i in range(samples):
        now = begin + i * dt
        for n in range(lates):
            for lane in range(LANES):
                lag = delays[n, lane] / h
                w[late_row + n, lane] = read_late(ring[:, :, lane], n, done, lag)
        for n in range(steps, calls.size):
            if when[n] < 0 or some(w, when[n]):
                called_at(calls[n], (w, now, h))
        if watched.size > 0:
            observed(i, read, watched, measured, gains, shown, leak, lead, moves)
            for g in range(count):
                for lane in range(LANES):
                    w[g, lane] += moves[g, lane]
                    kick = moves[count + g, lane] if w[count + g, lane] != 0.0 else 0.0
                    w[count + g, lane] += kick
                    w[2 * count + g, lane] += kick
            for n in range(lates):
                if late_of[n] < count:
                    for back in range(ring.shape[1]):
                        for lane in range(LANES):
                            ring[n, back, lane] += late_ratio[n, lane] * moves[late_of[n], lane]
        if closed:
            for lane in range(lanes):
                for k in range(sensors):
                    y[k] = read[k, lane]
                own = lane if target.shape[0] > 1 else 0
                other = lane if noise.shape[0] > 1 else 0
                added = noise[other, i] if noise.size > 0 else 0.0
                called_at(
                    control,
                    (i, now, dt, target[own, i], added, y, rules[lane], memory[lane], command),
                )
                for j in range(inputs):
                    w[signal + j, lane] = command[j]
        else:
            for j in range(inputs):
                for lane in range(lanes):
                    w[signal + j, lane] = u[lane if u.shape[0] > 1 else 0, j, i]
        if statistics:
            for n in range(size):
                value = found[0, n]
                found[1, n] = min(found[1, n], value)
                found[2, n] = max(found[2, n], value)
                found[3, n] += value
                found[4, n] += value * value
        if i == row * every:
            for c in range(columns.size):
                for lane in range(lanes):
                    out[lane, c, row] = w[reading + columns[c], lane]
            row += 1
        if late_inputs:
            for lane in range(lanes):
                for j in range(inputs):
                    kept[lane, j, i % room] = w[signal + j, lane]
        for k in range(substeps):
            for j in range(inputs if anew or k == 0 else 0):
                for lane in range(LANES):
                    w[u_row + j, lane] = w[signal + j, lane]
            if late_inputs:
                for lane in range(lanes):
                    for j in range(inputs):
                        begins = i + k / substeps - dead[j, lane]
                        w[u_row + j, lane] = held_average(
                            kept[lane], j, begins, begins + 1.0 / substeps, before
                        )
            t = now + (k + 0.5) * h
            for n in range(steps):
                if when[n] < 0 or some(w, when[n]):
                    called_at(calls[n], (w, t, h))
            done += 1
            for n in range(lates):
                for lane in range(LANES):
                    seen_now = late_ratio[n, lane] * w[late_of[n], lane]
                    ring[n, done % ring.shape[1], lane] = seen_now
