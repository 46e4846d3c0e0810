"""Motions and sensors of the certified problems, as the textbooks write them; states are in block order."""

from __future__ import annotations

from arithmetic import diag, eye, zeros
from mpmath import mp, mpf


def _blocks(dims, parts):
    """The matrix whose block (i, j) is diagonal with parts[i][j] for every axis."""
    order = len(parts)
    out = zeros(order * dims, order * dims)
    for i in range(order):
        for j in range(order):
            for axis in range(dims):
                value = parts[i][j]
                out[i * dims + axis][j * dims + axis] = value[axis] if isinstance(value, list) else mpf(value)
    return out


def _power_law(order, dims, dt, *, psd, std):
    """F and Q of `order` integrations of white noise (psd) or of an input constant over the step (std)."""
    f = [[dt ** (j - i) / mp.factorial(j - i) if j >= i else 0 for j in range(order)] for i in range(order)]
    q = [[None] * order for _ in range(order)]
    for i in range(order):
        for j in range(order):
            a, b = order - 1 - i, order - 1 - j  # powers of the elapsed time in the response to the noise
            if psd is not None:
                response = dt ** (a + b + 1) / ((a + b + 1) * mp.factorial(a) * mp.factorial(b))
                q[i][j] = [value * response for value in psd]
            else:
                response = dt ** (a + 1) / mp.factorial(a + 1) * dt ** (b + 1) / mp.factorial(b + 1)
                q[i][j] = [value**2 * response for value in std]
    return _blocks(dims, f), _blocks(dims, q)


def _singer(dt, accel_std, time_constant, accel_psd):
    """Singer's model of one axis each: F closed, Q the integral over the response, by quadrature."""
    dims = len(accel_std)

    def response(s, tau):
        e = mp.exp(-s / tau)
        return [tau**2 * (s / tau - 1 + e), tau * (1 - e), e]

    each = [response(dt, tau) for tau in time_constant]
    f = [
        [1, dt, [r[0] for r in each]],
        [0, 1, [r[1] for r in each]],
        [0, 0, [r[2] for r in each]],
    ]
    q = [[[mpf(0)] * dims for _ in range(3)] for _ in range(3)]
    for axis in range(dims):
        sigma, tau = accel_std[axis], time_constant[axis]
        for i in range(3):
            for j in range(3):

                def density(s, i=i, j=j, tau=tau):
                    r = response(s, tau)
                    return r[i] * r[j]

                with mp.extradps(30):  # the first two responses cancel where s is short beside tau
                    integral = mp.quad(density, [0, dt])
                q[i][j][axis] = 2 * sigma**2 / tau * integral
        white = accel_psd[axis]
        q[0][0][axis] += white * dt**3 / 3
        q[0][1][axis] += white * dt**2 / 2
        q[1][0][axis] += white * dt**2 / 2
        q[1][1][axis] += white * dt
    return _blocks(dims, f), _blocks(dims, q)


def transition(motion, dt):
    """F and Q over dt."""
    kind = motion["type"]
    if kind in {"linear", "linear_function"}:
        return (
            (motion["F"], motion["Q"]) if dt > 0 else (eye(len(motion["F"])), zeros(len(motion["F"]), len(motion["F"])))
        )
    if kind == "constant_velocity":
        return _power_law(2, motion["dims"], dt, psd=motion.get("accel_psd"), std=motion.get("accel_std"))
    if kind == "constant_acceleration":
        return _power_law(3, motion["dims"], dt, psd=motion.get("jerk_psd"), std=motion.get("jerk_std"))
    if kind == "singer":
        return _singer(dt, motion["accel_std"], motion["time_constant"], motion["accel_psd"])
    raise ValueError(kind)


def moved(motion, state, dt):
    """f(state) of a motion that is no matrix: a pendulum, (angle, rate)."""
    angle, rate = state
    rate = rate - dt * motion["stiffness"] * mp.sin(angle)
    return [angle + dt * rate, rate]


def noise(sensor):
    """R."""
    kind = sensor["type"]
    if kind in {"linear", "linear_function"}:
        return sensor["R"]
    if kind == "position":
        return diag([std**2 for std in sensor["std"]])
    if kind == "range_bearing":
        return diag([sensor["range_std"] ** 2, sensor["bearing_std"] ** 2])
    if kind == "range_array":
        depth = [] if sensor["depth_std"] is None else [sensor["depth_std"] ** 2]
        return diag([std**2 for std in sensor["range_std"]] + depth)
    if kind == "sine":
        return [[sensor["std"] ** 2]]
    raise ValueError(kind)


def observed(sensor, state):
    """h(state) and the derivative H."""
    kind, n = sensor["type"], len(state)
    if kind in {"linear", "linear_function"}:
        h = sensor["H"]
        return [sum((a * b for a, b in zip(row, state, strict=True)), mpf(0)) for row in h], h
    if kind == "position":
        dims = len(sensor["std"])
        return state[:dims], [[mpf(i == j) for j in range(n)] for i in range(dims)]
    if kind == "range_bearing":
        dx, dy = (state[i] - sensor["position"][i] for i in range(2))
        r = mp.sqrt(dx**2 + dy**2)
        rest = [mpf(0)] * (n - 2)
        return [r, mp.atan2(dy, dx)], [[dx / r, dy / r, *rest], [-dy / r**2, dx / r**2, *rest]]
    if kind == "range_array":
        values, rows = [], []
        dims = len(sensor["hydrophones"][0])
        for place in sensor["hydrophones"]:
            offset = [state[i] - place[i] for i in range(dims)]
            r = mp.sqrt(sum(x**2 for x in offset))
            values.append(r)
            rows.append([x / r for x in offset] + [mpf(0)] * (n - dims))
        if sensor["depth_std"] is not None:
            values.append(state[dims - 1])
            rows.append([mpf(i == dims - 1) for i in range(n)])
        return values, rows
    if kind == "sine":
        return [mp.sin(state[0])], [[mp.cos(state[0]), mpf(0)]]
    raise ValueError(kind)


def residual(sensor, measured, expected):
    """Measured minus expected, bearings on the circle."""
    out = [a - b for a, b in zip(measured, expected, strict=True)]
    if sensor["type"] == "range_bearing":
        out[1] -= 2 * mp.pi * mp.nint(out[1] / (2 * mp.pi))
    return out
