"""Reference versions of every kernel in plain Python, from the equations (docs/details.md), not from the kernels.

They run one sample at a time and are slow; nothing here is imported by the package.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import quad
from scipy.stats import t as student

TIE = 1e-9


def forces(S, J):
    """f_s and f_d (Shang et al., Eq. 1)."""
    return (S + J) / 2.0, (S - J) / 2.0


def sign(x):
    """-1, 0 or 1."""
    return int(x > 0) - int(x < 0)


def stenman(command, d):
    """If |e| > d: u_v = u, else hold."""
    v, out = command[0], []
    for u in command:
        if abs(u - v) > d + TIE:
            v = u
        out.append(v)
    return np.array(out)


def he(command, S, J):
    """If |e| > f_s: u_v = u - sign(e) f_d, else hold: the valve stops at every sample."""
    f_s, f_d = forces(S, J)
    v, out = command[0], []
    for u in command:
        e = u - v
        if abs(e) > f_s + TIE:
            v = u - sign(e) * f_d
        out.append(v)
    return np.array(out)


def he_wang(command, S, J, K):
    """If |e| > f_s: u_v = u_v(k-1) + K (e - sign(e) f_d), else hold."""
    f_s, f_d = forces(S, J)
    v, out = command[0], []
    for u in command:
        e = u - v
        if abs(e) > f_s + TIE:
            v = v + K * (e - sign(e) * f_d)
        out.append(v)
    return np.array(out)


def chen(command, S, J, v=None):
    """Two-layer tree: stuck -> hold or slip; moving -> slide while the command keeps its direction, else stop."""
    f_s, f_d = forces(S, J)
    v = command[0] if v is None else v
    moving, du_before, before, out = False, 0.0, command[0], []
    for u in command:
        du, e = u - before, u - v
        if moving and du * du_before > 0:
            v = u - sign(du) * f_d
        elif abs(e) > f_s + TIE:
            v, moving = u - sign(e) * f_d, True
        else:
            moving = False
        out.append(v)
        before, du_before = u, du
    return np.array(out)


def behind_positioner(command, S, J, rate, w=0.0, share=0.0, *, moving=False, stops=(-math.inf, math.inf), K=1.0,
                      fine=2000):
    """Mean positions under a positioner that adds rate times the integral of its error, in steps of 1/fine of a part.

    The stem rests until the force u + w - u_v exceeds f_s, and slips to where it is f_d, K times as far. The part that
    a row of a held command begins, or of a moving one ends, has the mean.
    """
    f_s, f_d = forces(S, J)
    v = min(max(command[0] + w - share * f_s, stops[0]), stops[1])
    before, out = command[0], []
    for u in command:
        total = 0.0
        for i in range(fine):
            now = before + (i + 0.5) / fine * (u - before) if moving else u
            e = now + w - v
            if abs(e) > f_s:
                slip = min(max(v + K * (e - sign(e) * f_d), stops[0]), stops[1])
                # At a stop the integral waits.
                w += rate / fine * (now - slip) * (slip != v or J == 0.0)
                v = slip
            else:
                w += rate / fine * (now - v)
            total += v / fine
        out.append(total)
        before = u
    return np.array(out)


def kano(command, S, J, d=1):
    """Kano 2004 from a friction-consistent start, u_v(0) = u_s - d f_d with u_v(0) = u(0)."""
    f_d = forces(S, J)[1]
    v = command[0]
    u_s, stopped = v + d * f_d, True
    before, du_before, out = command[0], 0.0, []
    for u in command:
        du = u - before
        if du * du_before <= 0 and not stopped:
            u_s, stopped = before, True
        if not stopped:
            v = u - d * f_d
        elif -d * (u - u_s) > S + TIE:
            d, stopped = -d, False
            v = u - d * f_d
        elif d * (u - u_s) > J + TIE:
            stopped = False
            v = u - d * f_d
        out.append(v)
        before, du_before = u, du
    return np.array(out)


def choudhury(command, S, J):
    """Choudhury 2005 with its known faults; outside 0..100 % it saturates."""
    f_d = forces(S, J)[1]
    v, xss, rested = command[0], command[0], True
    before, du_before, out = command[0], 0.0, []
    for u in command:
        du = u - before
        if u < 0.0 or u > 100.0:
            v = min(max(u, 0.0), 100.0)
        elif sign(du) != sign(du_before):
            xss = before
            if du == 0.0:
                rested = True
        elif abs(u - xss) > (J if rested else S) + TIE and du != 0.0:
            rested = False
            v = u - sign(du) * f_d
        out.append(v)
        before, du_before = u, du
    return np.array(out)


# Twins of the linear part -------------------------------------------------------------------------------------


def response(position, T1, T2, dead, integrating, step, fine=2000):
    """Response per unit of gain to a held position, by a very fine Euler-free recursion of each lag."""
    h = step / fine
    delay = round(dead / h)
    start = position[0]
    held = [float(p) - start for p in position for _ in range(fine)]
    x = z = total = 0.0
    out = [0.0]
    a1 = math.exp(-h / T1)
    a2 = math.exp(-h / T2) if T2 else 0.0
    for k in range(len(held) - fine):
        u = held[k - delay] if k >= delay else 0.0
        before = x
        x = u + (x - u) * a1
        mean_x = 0.5 * (before + x)
        last = z
        z = mean_x + (z - mean_x) * a2 if T2 else x
        total += h * (0.5 * (last + z))
        if (k + 1) % fine == 0:
            out.append(total if integrating else z)
    return np.array(out)


def least_squares(own, shared, target, weight):
    """Smallest sum of squares and the coefficients of the own columns, by numpy on the rows that count."""
    keep = weight > 0
    design = np.column_stack([*own, shared])[keep]
    solution, *_ = np.linalg.lstsq(design, target[keep], rcond=None)
    return float(np.sum((target[keep] - design @ solution) ** 2)), solution[:len(own)]


def fold_mean(own, shared, target, train):
    """Every candidate's prediction of all rows, weighed by the likelihood of the training rows; own is (k, n, P)."""
    told, weights = [], []
    for p in range(own.shape[2]):
        design = np.column_stack([*own[:, :, p], shared])
        solution, *_ = np.linalg.lstsq(design[train], target[train], rcond=None)
        cost = np.sum((target[train] - design[train] @ solution) ** 2)
        told.append(design @ solution)
        weights.append(cost ** (-0.5 * train.sum()))
    return np.average(told, axis=0, weights=np.array(weights) / max(weights))


def filtered(columns, taps):
    """1 + taps[0] q^-1 + … applied row by row."""
    out = np.array(columns, dtype=float)
    for k in range(len(columns)):
        for i, tap in enumerate(taps):
            if k - 1 - i >= 0:
                out[k] = out[k] + tap * columns[k - 1 - i]
    return out


def whitening_of_first(taps, long=4000):
    """The inverse Cholesky factor of the covariance of the first samples of an AR model with innovations of 1."""
    impulse = np.zeros(long)
    impulse[0] = 1.0
    for k in range(1, long):
        for i, tap in enumerate(taps):
            if k - 1 - i >= 0:
                impulse[k] -= tap * impulse[k - 1 - i]
    p = len(taps)
    covariance = np.array([[impulse[:long - abs(i - j)] @ impulse[abs(i - j):] for j in range(p)] for i in range(p)])
    return np.linalg.inv(np.linalg.cholesky(covariance))


def interval_means(command, f_s, position):
    """Mean position over the part before each row, with the break-away where |e| reaches f_s on the way."""
    means = [position[0]]
    for j in range(1, len(command)):
        du, moved = command[j] - command[j - 1], position[j] - position[j - 1]
        if moved == 0.0:
            share = 1.0
        elif abs(moved - du) < 1e-9:
            share = 0.0
        else:
            force = math.copysign(1.0, moved) * (command[j - 1] - position[j - 1])
            share = min(max((f_s - force) / abs(du), 0.0), 1.0)
        rest = 1.0 - share
        means.append(share * position[j - 1] + rest * (position[j] - 0.5 * rest * du))
    return np.array(means)


def arx_cost(command, process_value, S, J, order, delay, first, constant=False):
    """The paper's V_N (Eq. 12 to 19) by numpy.linalg.lstsq over rows first..; deviations from means, u_v(0) = u(0).

    With `constant` an offset is fitted, too.
    """
    v = np.asarray(chen(command, S, J)) - np.mean(command)
    y = process_value - process_value[first:].mean()
    n = len(y)
    phi = np.column_stack([y[first - i:n - i] for i in range(1, order + 1)]
                          + [v[first - delay - i:n - delay - i] for i in range(1, order + 1)]
                          + [np.ones(n - first)] * constant)
    theta, *_ = np.linalg.lstsq(phi, y[first:], rcond=None)
    return float(np.mean((y[first:] - phi @ theta) ** 2))


def restarted_cost(segments, S, J, forces_, T, dead, *, step, skip, integrating=False, taps=()):
    """Smallest sum of squares of one valve and one process over segments (command, y): gain common, level, drift and
    start-up of each segment its own, all of it in one wide design, restarted and filtered segment by segment."""
    f_s = forces(S, J)[0]
    goal, blocks, keeps = [], [], []
    for (command, y), share, first in zip(segments, forces_, skip, strict=True):
        v = chen(command, S, J, v=command[0] - share * f_s)
        n = len(y)
        own = [response(v, T, 0.0, dead, integrating, step, fine=200), np.exp(-np.arange(n) * step / T), np.ones(n)]
        if integrating:
            own.append(np.arange(n) / n)
        blocks.append(np.stack([filtered(column, taps) for column in own], axis=1))
        goal.append(filtered(y, taps))
        keeps.append(np.arange(n) >= max(first, len(taps)))
    rows, local = sum(len(b) for b in blocks), blocks[0].shape[1] - 1
    design, at = np.zeros((rows, 1 + local * len(blocks))), 0
    for i, block in enumerate(blocks):
        design[at:at + len(block), 0] = block[:, 0]
        design[at:at + len(block), 1 + i * local:1 + (i + 1) * local] = block[:, 1:]
        at += len(block)
    keep, goal = np.concatenate(keeps), np.concatenate(goal)
    solution, *_ = np.linalg.lstsq(design[keep], goal[keep], rcond=None)
    return float(np.sum((goal[keep] - design[keep] @ solution) ** 2)), float(solution[0])


def crossings(signal, band):
    """Fractional times of up-crossings of zero between a sample below -band and the next one above +band."""
    found, k = [], 0
    while k < len(signal):
        if signal[k] < -band:
            up = next((j for j in range(k + 1, len(signal)) if signal[j] > band), None)
            if up is None:
                break
            # The first upward crossing after the last sample below -band.
            last = max(j for j in range(k, up) if signal[j] < -band)
            at = next(j for j in range(last + 1, up + 1) if signal[j - 1] < 0.0 <= signal[j])
            found.append(at - 1 + signal[at - 1] / (signal[at - 1] - signal[at]))
            k = up
        k += 1
    return np.array(found)


def repaired(setpoint, residual, estimate, law, start_u, start_y, step):
    """y and u of a PI loop whose valve follows its command, on a grid six times as fine as its fastest number."""
    lags = [t for t in estimate.time_constants_s if t > 0]
    fastest = min([*lags, estimate.dead_time_s or math.inf, step * 6])
    parts = int(min(max(math.ceil(6 * step / fastest), 1), 20))
    h = step / parts
    delay = round(estimate.dead_time_s / h)
    sent, x, level, total, ys, us = [], [0.0] * len(lags), 0.0, 0.0, [], []
    for r, rest in zip(setpoint, residual, strict=True):
        for _ in range(parts):
            arrived = sent[-1 - delay] if delay < len(sent) else 0.0
            out = level if estimate.integrating else (x[-1] if x else arrived)
            y = start_y + estimate.gain * out + rest
            total += law.gain / law.integral_time_s * h * (r - y)
            u = start_u + law.gain * (r - y) + total
            sent.append(u - start_u)
            value = sent[-1 - delay] if delay < len(sent) else 0.0
            for i, t in enumerate(lags):
                x[i] = value + (x[i] - value) * math.exp(-h / t)
                value = x[i]
            level += h * value
        ys.append(y)
        us.append(u)
    return np.array(ys), np.array(us)


def adapted(mean, sigma, cov, path_s, path_c, steps, w, constants, turn, top):
    """One generation of covariance matrix adaptation (Hansen 2016): `steps` (mu, d) of the best, best first."""
    mueff, cc, cs, c1, cmu, damps, chi = constants
    d = len(mean)
    step = w @ steps
    values, vectors = np.linalg.eigh(cov)
    white = vectors @ np.diag(values**-0.5) @ vectors.T @ step
    path_s = (1 - cs) * path_s + np.sqrt(cs * (2 - cs) * mueff) * white
    length = np.linalg.norm(path_s)
    quiet = length / np.sqrt(1 - (1 - cs) ** (2 * (turn + 1))) < (1.4 + 2 / (d + 1)) * chi
    path_c = (1 - cc) * path_c + quiet * np.sqrt(cc * (2 - cc) * mueff) * step
    rank_mu = sum(wi * np.outer(s, s) for wi, s in zip(w, steps, strict=True))
    cov = ((1 - c1 - cmu + (0.0 if quiet else c1 * cc * (2 - cc))) * cov + c1 * np.outer(path_c, path_c)
           + cmu * rank_mu)
    return (np.clip(mean + sigma * step, 0.0, top), sigma * np.exp(np.clip(cs / damps * (length / chi - 1), -1, 1)),
            cov, path_s, path_c)


def hansen(lam, d):
    """Weights of the best half of `lam` points and constants of their adaptation in `d` dimensions (Hansen 2016)."""
    mu = lam // 2
    w = np.array([math.log(mu + 0.5) - math.log(i) for i in range(1, mu + 1)])
    w = w / sum(w)
    mueff = 1 / sum(w**2)
    cc, cs = (4 + mueff / d) / (d + 4 + 2 * mueff / d), (mueff + 2) / (d + mueff + 5)
    c1 = 2 / ((d + 1.3) ** 2 + mueff)
    cmu = min(1 - c1, 2 * (mueff - 2 + 1 / mueff) / ((d + 2) ** 2 + mueff))
    damps = 1 + 2 * max(0, math.sqrt((mueff - 1) / (d + 1)) - 1) + cs
    return w, np.array([mueff, cc, cs, c1, cmu, damps, math.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d * d))])


def noise_covariance(taps, rho, theta, samples, burn=4000):
    """Covariance of a noise process with unit innovations from its impulse response, and of its walk from time 0.

    A (1 - rho q^-1) v = (1 - theta q^-1) e. For rho = 1 the walk starts at v(-1) = 0 with settled differences; its
    level is left out.
    """
    a, walks = np.array([1.0, *taps]), rho == 1.0 and theta < 1.0
    if rho == theta:
        rho = theta = 0.0
    if not walks:
        a = np.convolve(a, [1.0, -rho])
    total = burn + samples
    h = []
    for k in range(total):
        past = sum(a[i] * h[k - i] for i in range(1, min(k, a.size - 1) + 1))
        h.append((1.0 if k == 0 else -theta if k == 1 else 0.0) - past)
    h = np.array(h)
    gamma = np.array([h[:total - k] @ h[k:] for k in range(samples)])
    out = gamma[np.abs(np.subtract.outer(np.arange(samples), np.arange(samples)))]
    if walks:
        sums = np.tril(np.ones((samples, samples)))
        out = sums @ out @ sums.T
    return out


def noise_likelihood(residual, good, starts, taps, rho, theta):
    """Sum of squares and log-determinant of the good samples, missing rows dropped and levels integrated out."""
    sse = logdet = 0.0
    for a, b in zip(starts, [*starts[1:], len(residual)], strict=True):
        keep = np.flatnonzero(good[a:b])
        V = noise_covariance(taps, rho, theta, b - a)[np.ix_(keep, keep)]
        y, one = residual[a:b][keep], np.ones(keep.size)
        L = np.linalg.cholesky(V)
        e, g = np.linalg.solve(L, y), np.linalg.solve(L, one)
        sse += e @ e - (e @ g) ** 2 / (g @ g)
        logdet += 2.0 * np.log(np.diag(L)).sum() + np.log(g @ g)
    return sse, logdet


def series(position, T1, L, T2, numerator, denominator, integrating, step_s, substeps, fine=400):
    """Response (n,) at the samples of lags, numerator(s) / denominator(s) and an integral, by Runge-Kutta steps.

    Coefficients are in falling powers of s. The position is held over each part; the response starts from rest and is
    that just before the move at the sample.
    """
    top, bottom = np.array([1.0]), np.array([1.0])
    for lag in (T1, T2):
        if lag > 0:
            bottom = np.polymul(bottom, [lag, 1.0])
    top, bottom = np.polymul(top, numerator), np.polymul(bottom, denominator)
    if integrating:
        bottom = np.polymul(bottom, [1.0, 0.0])
    top = np.concatenate([np.zeros(bottom.size - top.size), top]) / bottom[0]
    bottom = bottom / bottom[0]
    m = bottom.size - 1
    direct = top[0]
    part = step_s / substeps
    h = part / fine

    def change(x, u):
        # Observer form: x_i' = -a_i x_0 + x_(i+1) + (b_i - a_i b_0) u.
        return [-bottom[i + 1] * x[0] + (x[i + 1] if i + 1 < m else 0.0) + (top[i + 1] - bottom[i + 1] * direct) * u
                for i in range(m)]

    def moved(x, k, share):
        return [a + share * h * b for a, b in zip(x, k, strict=True)]

    x, out = [0.0] * m, [0.0]
    for k in range((position.size // substeps - 1) * substeps * fine):
        age = (k + 0.5) * h - L
        u = position[int(age / part)] - position[0] if age >= 0.0 else 0.0
        k1 = change(x, u)
        k2 = change(moved(x, k1, 0.5), u)
        k3 = change(moved(x, k2, 0.5), u)
        k4 = change(moved(x, k3, 1.0), u)
        x = [a + h / 6.0 * (p + 2.0 * q + 2.0 * r + s) for a, p, q, r, s in zip(x, k1, k2, k3, k4, strict=True)]
        if (k + 1) % (substeps * fine) == 0:
            out.append(x[0] + direct * u)
    return np.array(out)


def directional(position, T, L, ratio, step_s, fine=4000, growth=0.0):
    """T x' = u(t - L(t)) - x, with ratio T where x falls and L(t) = L + growth t; (n,) at the samples."""
    h, x, out = step_s / fine, 0.0, [0.0]
    for k in range((position.size - 1) * fine):
        at = (k + 0.5) * h
        age = at - max(L + growth * at, 0.0)
        u = position[int(age / step_s)] - position[0] if age >= 0.0 else 0.0
        x += h * (u - x) / (T if u > x else ratio * T)
        if (k + 1) % fine == 0:
            out.append(x)
    return np.array(out)


def burg(chains, lags):
    """Autocovariances of the autoregression with the least squared errors of prediction forwards and backwards.

    Burg 1975: one reflection coefficient at a time, Levinson's taps, every sum taken over the samples of each chain.
    """
    count = sum(len(x) for x in chains)
    variance = sum(value**2 for x in chains for value in x) / count
    taps, covariance = [1.0], [variance]
    for order in range(1, lags + 1):
        both, power = 0.0, 0.0
        for x in chains:
            for k in range(order, len(x)):
                ahead = sum(a * x[k - i] for i, a in enumerate(taps))
                behind = sum(a * x[k - order + i] for i, a in enumerate(taps))
                both, power = both + ahead * behind, power + ahead**2 + behind**2
        reflection = -2.0 * both / power
        longer = [*taps, 0.0]
        taps = [a + reflection * b for a, b in zip(longer, longer[::-1], strict=True)]
        # Yule and Walker: the taps of this order have no covariance with the past of this order.
        covariance.append(-sum(a * covariance[order - i] for i, a in enumerate(taps) if i))
        variance *= 1.0 - reflection**2
    return np.array(covariance), np.array(taps[1:]), variance


def student_log_likelihood(values, freedom):
    """Greatest log-likelihood of a Student distribution over its scale, by nested grids of the density itself."""
    def whole(scale):
        head = math.lgamma((freedom + 1.0) / 2.0) - math.lgamma(freedom / 2.0) - 0.5 * math.log(freedom * math.pi)
        return sum(head - math.log(scale) - (freedom + 1.0) / 2.0 * math.log(1.0 + (x / scale) ** 2 / freedom)
                   for x in values)

    low, high = -12.0, 12.0
    for _ in range(40):
        grid = [low + (high - low) * i / 20 for i in range(21)]
        best = max(range(21), key=lambda i: whole(math.exp(grid[i])))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 20)]
    return whole(math.exp(0.5 * (low + high)))


def stroke_score(before, after, half):
    """Sum of log-likelihood gains of half cycles, over their spread; innovations that are NaN don't count."""
    rows = [(t, e * e, a * a) for t, (e, a) in enumerate(zip(before, after, strict=True)) if e == e and a == a]
    old, new = sum(r[1] for r in rows) / len(rows), sum(r[2] for r in rows) / len(rows)
    gains = [0.0] * (rows[-1][0] // half + 1)
    for t, e, a in rows:
        gains[t // half] += math.log(old / new) + e / old - a / new
    mean = sum(gains) / len(gains)
    return sum(gains) / math.sqrt(sum((g - mean) ** 2 for g in gains))


def controller_numbers(u, r, y, step_s, derivative):
    """Gain, integral and derivative time of u = c + K e + (K h / T_i) sum(e) + (K T_d / h) (e - e before)."""
    rows, total, before = [], 0.0, None
    for a, b in zip(r, y, strict=True):
        e = a - b
        total += e
        rows.append([1.0, e, total, *([0.0 if before is None else e - before] if derivative else [])])
        before = e
    first = 2 if derivative else 1  # of a record, and where it is used also of a stretch
    rows, u = rows[first:], list(u)[first:]
    p = len(rows[0])
    table = [[math.fsum(row[i] * row[j] for row in rows) for j in range(p)]
             + [math.fsum(row[i] * value for row, value in zip(rows, u, strict=True))] for i in range(p)]
    for i in range(p):
        pivot = max(range(i, p), key=lambda k: abs(table[k][i]))
        table[i], table[pivot] = table[pivot], table[i]
        for k in range(p):
            if k != i:
                share = table[k][i] / table[i][i]
                table[k] = [a - share * b for a, b in zip(table[k], table[i], strict=True)]
    sizes = [table[i][-1] / table[i][i] for i in range(p)]
    return sizes[1], sizes[1] / sizes[2] * step_s, sizes[3] / sizes[1] * step_s if derivative else 0.0


def normal_above(x):
    """Chance that a standard normal number exceeds x."""
    return 0.5 * math.erfc(x / math.sqrt(2.0))


def paths(command, S, J, scatter, error=0.0, rests=False, start=None):
    """Every path of a short record, as (events, positions, log chance): docs/details.md, section 14, word for word.

    An event is a sample and its kind; of a slip also the largest force before, and that at it, beyond f_s.

    The break-away force is drawn anew for every stick, either way, from N(f_s, scatter^2). A sliding stem stops, or
    slides on, against what the command says with the chance that its turn is an error of the command.
    """
    f_s, f_d = forces(S, J)

    def above(x):
        return 1.0 if x == -math.inf else normal_above(x / scatter)

    # valve: position, heading (0 at rest), largest margin up and down; then events, positions, log chance
    alive = [(command[0] if start is None else start, 0, -math.inf, -math.inf, (), (), 0.0)]
    for k, u in enumerate(command):
        du = u - command[k - 1] if k else 0.0
        after = []
        for v, heading, up, down, events, places, chance in alive:
            ways = []
            if heading:
                on = du * heading > 0.0
                doubt = normal_above(abs(du) / (math.sqrt(2.0) * error)) if error else 0.0
                ways.append((on, events, chance + math.log(1.0 - doubt)))
                if doubt:
                    ways.append((not on, (*events, (k, 2)), chance + math.log(doubt)))
            else:
                ways.append((False, events, chance))
            for on, happened, weight in ways:
                if on:
                    at = max(u - f_d, v) if heading > 0 else min(u + f_d, v)
                    after.append((at, heading, -math.inf, -math.inf, happened, (*places, at), weight))
                    continue
                a, c = (-math.inf, -math.inf) if heading else (up, down)
                rise, fall = u - v - f_s - TIE, v - u - f_s - TIE
                way = 1 if rise > fall else -1
                now, old = (rise, a) if way > 0 else (fall, c)
                p = 1.0 - above(now) / above(old) if now > old else 0.0
                if p < 1.0:
                    after.append((v, 0, max(a, rise), max(c, fall), happened, (*places, v),
                                  weight + math.log(1.0 - p)))
                if p > 0.0:
                    at = u - way * f_d
                    after.append((at, 0 if rests else sign(du), -math.inf, -math.inf, (*happened, (k, way, old, now)),
                                  (*places, at), weight + math.log(p)))
        alive = after
    return [(events, places, chance) for *_, events, places, chance in alive]


def rebuilt_doubts(command, error, parts, digits):
    """Chance of a turn that the record does not show, for a command rebuilt in parts of a sample (section 14)."""
    def chance(move, sd):
        known = abs(move) / (math.sqrt(2.0) * sd) if sd else math.inf
        return normal_above(known) if known <= 4.0 else 0.0

    out = [0.0]
    for i in range(1, len(command)):
        begins = (i - 1) % parts == 0
        turns = i >= 2 and (command[i] - command[i - 1]) * (command[i - 1] - command[i - 2]) <= 0.0
        ahead = command[min(i - 1 + parts, len(command) - 1)] - command[i - 1]
        wrong = chance(command[i] - command[i - 1], math.sqrt(max(error**2 - digits**2, 0.0)))
        if begins or turns:
            other = chance(ahead, min(digits, error))
            wrong = wrong * (1.0 - other) + other * (1.0 - wrong)
        out.append(wrong)
    return np.array(out)


def lagged(places, decay):
    """Response of one lag that decays by `decay` a sample to positions held from sample to sample."""
    x = [0.0]
    for place in places[:-1]:
        x.append(decay * x[-1] + (1.0 - decay) * place)
    return np.array(x)


def between(low, high, scatter, points=2001):
    """Mean and variance of N(0, scatter^2) between low and high, by sums over points."""
    x = np.linspace(max(low, -8.0 * scatter), min(high, 8.0 * scatter), points)
    weight = np.exp(-0.5 * (x / scatter) ** 2)
    weight[[0, -1]] *= 0.5
    middle = float(weight @ x / weight.sum())
    return middle, float(weight @ (x - middle) ** 2 / weight.sum())


def landing(events, places, scatter, error):
    """Expected error (n,) of a stem that lands where a command with an error puts it, and its independent parts (n, n).

    A stem that slides has the error of the command. At a slip the force lies w - e beside f_s but for a part of its own
    (variance scatter^2 - 2 error^2, and what the record does not show of it), w the error before and e the one after.
    """
    n, w, part = len(places), 0.0, np.zeros(len(places))
    mean, parts, slips = np.zeros(n), np.zeros((n, n)), {e[0]: e for e in events if len(e) > 2}
    for k in range(n):
        if k in slips:
            _, way, before, now = slips[k]
            middle, spread = between(before, max(now, before + 1e-9), scatter)
            own = max(scatter**2 - 2.0 * error**2, 0.01 * scatter**2) + spread
            share = error**2 / (error**2 + own)
            w, part = share * (w - way * middle), share * part
            part[k] = error * math.sqrt(1.0 - share)
        elif k and places[k] != places[k - 1]:
            w, part = 0.0, np.zeros(n)
            part[k] = error
        mean[k], parts[k] = w, part
    return mean, parts


def pulse_of(k, step, decay, samples):
    """Output (samples,) behind a `step` of the stem that comes one command early; the command says it at k."""
    early = np.zeros(samples)
    early[k] = step
    return decay * lagged(early, decay)


def stayed(force, mean, wide, error):
    """Chance that a stem stays, and mean and variance of its force N(mean, wide) then; the command errs by N(0, error).

    Sums over the force. All are in %, and the forces lie beyond f_s.
    """
    if not error:
        middle, spread = between(force - mean, math.inf, math.sqrt(wide))
        return normal_above((force - mean) / math.sqrt(wide)), mean + middle, spread
    x = mean + math.sqrt(wide) * np.linspace(-9.0, 9.0, 4001)
    weight = np.exp(-0.5 * (x - mean)**2 / wide)
    weight /= weight.sum()
    stays = weight * np.array([normal_above((force - one) / math.sqrt(error)) for one in x])
    chance = float(stays.sum())
    middle = float(stays @ x) / chance
    return chance, middle, float(stays @ (x - middle)**2) / chance


def slipped(force, mean, wide, error):
    """Mean and variance of the error N(0, error) of a command at which a stem slips; sums over the error."""
    if not error:
        return 0.0, 0.0
    x = math.sqrt(error) * np.linspace(-9.0, 9.0, 4001)
    weight = np.exp(-0.5 * x**2 / error) * np.array([normal_above((mean - force - one) / math.sqrt(wide)) for one in x])
    weight /= weight.sum()
    middle = float(weight @ x)
    return middle, float(weight @ (x - middle)**2)


def scan_paths(command, S, J, own, errors, error, rests=False):
    """Every path of a short record whose command errs by itself at each sample, as (events, positions, log chance).

    docs/details.md, section 14, word for word: `errors` are variances, `own` that of the force of a stick. A slip holds
    the share of the last landing's error in the next one, and the variance of its own.
    """
    f_s, f_d = forces(S, J)
    new = {1: (0.0, own), -1: (0.0, own)}
    # valve: position, heading (0 at rest), force by way, variance of its landing; then events, positions, log chance
    alive = [(command[0], 0, new, 0.0, (), (), 0.0)]
    for k, u in enumerate(command):
        du = u - command[k - 1] if k else 0.0
        after = []
        for v, heading, force, landed, events, places, chance in alive:
            ways = [(False, events, chance)]
            if heading:
                on, doubt = du * heading > 0.0, normal_above(abs(du) / (math.sqrt(2.0) * error)) if error else 0.0
                ways = [(on, events, chance + math.log(1.0 - doubt))]
                if doubt:
                    ways.append((not on, (*events, (k, 2)), chance + math.log(doubt)))
            for on, happened, weight in ways:
                if on:
                    at = max(u - f_d, v) if heading > 0 else min(u + f_d, v)
                    missed = errors[k] if at != v else landed
                    after.append((at, heading, force, missed, happened, (*places, at), weight))
                    continue
                felt = {1: (0.0, own + landed), -1: (0.0, own + landed)} if heading else force
                rise, fall = u - v - f_s - TIE, v - u - f_s - TIE
                way, now = (1, rise) if rise > fall else (-1, fall)
                p, *moments = stayed(now, *felt[way], errors[k])
                if p > 0.0:
                    after.append((v, 0, {**felt, way: tuple(moments)}, landed, happened, (*places, v),
                                  weight + math.log(p)))
                if p < 1.0:
                    early, spread = slipped(now, *felt[way], errors[k])
                    share = (slipped(now - 1e-4, *felt[way], errors[k])[0]
                             - slipped(now + 1e-4, *felt[way], errors[k])[0]) / 2e-4
                    at = u + way * (early - f_d)
                    anew = {1: (0.0, own + spread), -1: (0.0, own + spread)}
                    after.append((at, 0 if rests else way, anew, spread, (*happened, (k, way, share, spread)),
                                  (*places, at), weight + math.log(1.0 - p)))
        alive = after
    return [(events, places, chance) for *_, events, places, chance in alive]


def scan_landing(events, places, errors):
    """As `landing`, of a command that errs by itself at each sample: what is expected is in the places."""
    part, parts, slips = np.zeros(len(places)), np.zeros((len(places), len(places))), {e[0]: e for e in events
                                                                                     if len(e) > 2}
    for k in range(len(places)):
        if k in slips:
            part = slips[k][2] * part
            part[k] = math.sqrt(slips[k][3])
        elif k and places[k] != places[k - 1]:
            part = np.zeros(len(places))
            part[k] = math.sqrt(errors[k])
        parts[k] = part
    return np.zeros(len(places)), parts


def path_likelihood(path, target, gain, decay, taps=(), scatter=1.0, error=0.0, jitter=0.0, landed=None, late=None):
    """Log chance of a path and of a record (noise of size 1) whose process is one lag that decays by `decay` a sample.

    The stem lands with the `error` of the command. Its slips come early or late by `jitter`, in samples, and all its
    moves by `late` (n,). Without the constants of the normal distribution. Innovations count from the sample that the
    taps can look back on. What is `landed` stands in place of `landing`.
    """
    events, places, chance = path
    mean, parts = landed or landing(events, places, scatter, error)
    steps = np.diff(places, prepend=places[0])
    columns = np.array([*(gain * lagged(part, decay) for part in parts.T),
                        *(gain * jitter * pulse_of(e[0], steps[e[0]], decay, len(places)) for e in events
                          if len(e) > 2),
                        *(gain * late[k] * pulse_of(k, steps[k], decay, len(places))
                          for k in ([] if late is None else np.flatnonzero(steps)))])
    factor = np.linalg.cholesky(np.eye(len(places)) + columns.T @ columns)
    errors = np.linalg.solve(factor, target - gain * lagged(np.array(places) - places[0] + mean, decay))
    total = chance
    for k in range(len(taps), len(target)):
        innovation = errors[k] + sum(t * errors[k - 1 - i] for i, t in enumerate(taps))
        total -= 0.5 * innovation**2 + math.log(factor[k, k])
    return total


def load_covariance(keep: float, root: float, ratio: float, lags: int) -> np.ndarray:
    """Autocovariances (lags + 1,) of AR(1) noise with a root behind a lag that keeps a share of its state a sample.

    Innovations of the whole have unit variance where `ratio`, the variance of white noise beside it, is 0. Summed from
    impulse responses, one product at a time.
    """
    pulse, load, state = [], 1.0, 0.0
    for _ in range(4000):
        state = keep * state + load
        pulse.append(state)
        load *= root
    pulse = np.array(pulse)
    found = np.array([pulse[lag:] @ pulse[:pulse.size - lag] for lag in range(lags + 1)])
    found[0] += ratio
    return found


def prediction_error(covariance: np.ndarray) -> float:
    """Variance that the best linear predictor from all but the newest of the samples leaves."""
    n = covariance.size - 1
    whole = np.array([[covariance[abs(i - j)] for j in range(n)] for i in range(n)])
    return float(covariance[0] - covariance[1:] @ np.linalg.solve(whole, covariance[1:]))



def probability_of_sticking(blocks, numbers: int, samples: int, prior: float, left: float | None = None) -> float:
    """Posterior odds of friction, its 2 log L a mean over Student's distribution that the blocks leave it."""
    ratio, scatter = sum(blocks), float(np.std(blocks, ddof=1)) * len(blocks)**0.5
    cost = numbers * np.log(samples) if left is None else (numbers - 1) * np.log(samples) - 2.0 * np.log(left)

    def weighed(z: float) -> float:
        odds = prior / (1.0 - prior) * np.exp(np.clip((ratio + scatter * z - cost) / 2.0, -500.0, 500.0))
        return odds / (1.0 + odds) * student.pdf(z, len(blocks) - 1)

    return sum(quad(weighed, low, low + 1.0)[0] for low in np.arange(-60.0, 60.0))
