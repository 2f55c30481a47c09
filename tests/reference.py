"""The paper's procedures line by line, in exact rationals: slow, obvious, and right.

Every fast path must equal these. Inputs are floats, taken at their exact value. Outside
the range, which the paper leaves open, the slope of gear n - 1 goes on.
"""

from fractions import Fraction


def find_first_one(bits):
    """S = f1(B) (4); n where there is none."""
    for i, bit in enumerate(bits):
        if bit == 1:
            return i
    return len(bits)


def find_first_zero(bits):
    """Z = f0(B) (5); n where there is none."""
    for i, bit in enumerate(bits):
        if bit == 0:
            return i
    return len(bits)


class Backlash:
    """A discrete backlash operator, (1)-(12); ``bits[i]`` is b_i."""

    def __init__(self, dx, dy, x0, y0, state=0):
        self.dx = [Fraction(width) for width in dx]
        self.dy = [Fraction(width) for width in dy]
        self.x0, self.y0 = Fraction(x0), Fraction(y0)
        self.bits = [state >> i & 1 for i in range(len(self.dx))]

    @property
    def state(self):
        """B (1)."""
        return sum(bit << i for i, bit in enumerate(self.bits))

    def coordinates(self):
        """X_B (2) and Y_B (3)."""
        crossed = [i for i, bit in enumerate(self.bits) if bit == 1]
        x_b = sum((self.dx[i] for i in crossed), self.x0)
        y_b = sum((self.dy[i] for i in crossed), self.y0)
        return x_b, y_b

    def step(self, value):
        """Steps 1 to 4 of the procedure, repeated until there is an output."""
        x = Fraction(value)
        n = len(self.bits)
        x_b, y_b = self.coordinates()
        while True:
            s, z = find_first_one(self.bits), find_first_zero(self.bits)
            if (z == n and x >= x_b) or (s == n and x < x_b):  # beyond the range
                return y_b + self.dy[n - 1] / self.dx[n - 1] * (x - x_b)
            if z < n and x_b <= x < x_b + self.dx[z]:
                return y_b + self.dy[z] / self.dx[z] * (x - x_b)  # (11)
            if z < n and x >= x_b + self.dx[z]:
                self.bits[z] = 1  # (6)-(7)
                x_b, y_b = x_b + self.dx[z], y_b + self.dy[z]
                continue
            if s < n and x_b - self.dx[s] < x < x_b:
                return y_b + self.dy[s] / self.dx[s] * (x - x_b)  # (12)
            self.bits[s] = 0  # (8)-(9)
            x_b, y_b = x_b - self.dx[s], y_b - self.dy[s]


class Relaxed:
    """Gears with memories beside them: u = Gamma(v) + sum c_j L_j; the decays a_j are taken as they are."""

    def __init__(self, gears, reference, gain):
        self.gears = gears
        self.reference = Fraction(reference)
        self.gain = [Fraction(c) for c in gain]
        self.memory = None  # at rest at the first sample

    def step(self, value, decay):
        """One sample of the voltage."""
        drive = Fraction(value) - self.reference
        if self.memory is None:
            self.memory = [drive for _ in self.gain]
        for j, a in enumerate(decay):
            self.memory[j] = Fraction(a) * self.memory[j] + (1 - Fraction(a)) * drive
        known = sum(
            (c * m for c, m in zip(self.gain, self.memory, strict=True)), Fraction(0)
        )
        return self.gears.step(value) + known

    def undo(self, target, decay, low, high):
        """The voltage in [low, high] whose output is nearest to a target; after it the state is ``step``'s.

        What the memories keep of the past is known. What is left is
        Gamma(v) + kappa (v - reference), kappa = sum c_j (1 - a_j): an operator with
        heights dY + kappa dX, undone by exchanging its axes.
        """
        a = [Fraction(value) for value in decay]
        if self.memory is None:
            a = [Fraction(0) for _ in self.gain]
        past = self.memory or a
        terms = list(zip(self.gain, a, past, strict=True))
        known = sum((c * keep * old for c, keep, old in terms), Fraction(0))
        kappa = sum((c * (1 - keep) for c, keep, _ in terms), Fraction(0))
        gears = self.gears
        steep = [h + kappa * w for w, h in zip(gears.dx, gears.dy, strict=True)]
        height = gears.y0 + kappa * (gears.x0 - self.reference)
        exchanged = Backlash([], [], 0.0, 0.0)
        exchanged.dx, exchanged.dy = steep, gears.dx
        exchanged.x0, exchanged.y0, exchanged.bits = height, gears.x0, gears.bits[:]
        voltage = exchanged.step(Fraction(target) - known)
        voltage = min(max(voltage, Fraction(low)), Fraction(high))
        self.step(voltage, decay)
        return voltage


def point(dx, dy, x0, y0, values):
    """A discrete point operator, (13)-(16), over a signal, its state C starting at 0."""
    widths, heights = [Fraction(w) for w in dx], [Fraction(w) for w in dy]
    c, outputs = 0, []
    for value in values:
        x = Fraction(value)
        while True:
            x_c = Fraction(x0) + sum(widths[:c], Fraction(0))  # (13)
            y_c = Fraction(y0) + sum(heights[:c], Fraction(0))  # (14)
            if x > x_c + widths[c] and c < len(widths) - 1:
                c += 1
            elif x < x_c and c > 0:
                c -= 1
            else:
                outputs.append(y_c + heights[c] / widths[c] * (x - x_c))  # (16)
                break
    return outputs
