/* Preisach with cells. State: number of dominant extrema, the extrema, and the relays' output on each. */
static int @f@_cell(const double *at, int count, double u)
{
    int low = 0, high = count - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (at[middle] <= u)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static double @f@_everett(double above, double below)
{
    const int i = @f@_cell(@f@_levels, @M@_LEVELS_SIZE, above), j = @f@_cell(@f@_levels, @M@_LEVELS_SIZE, below);
    const double p = fmin(fmax((above - @f@_levels[i]) / (@f@_levels[i + 1] - @f@_levels[i]), 0.0), 1.0);
    const double q = fmin(fmax((below - @f@_levels[j]) / (@f@_levels[j + 1] - @f@_levels[j]), 0.0), 1.0);
    const double *row = @f@_off + i * @M@_LEVELS_SIZE + j;
    const double near = (1 - q) * row[0] + q * row[1];
    const double far = (1 - q) * row[@M@_LEVELS_SIZE] + q * row[@M@_LEVELS_SIZE + 1];
    double diagonal;
    if (i == j)
        diagonal = (p - q) * (p - q) * @f@_diagonal[i];
    else
        diagonal = @f@_sums[i] - @f@_sums[j + 1] + p * p * @f@_diagonal[i] + (1 - q) * (1 - q) * @f@_diagonal[j];
    return (1 - p) * near + p * far + diagonal;
}

/* A first excursion is quadratic between the knots, the single-valued part straight, and straight beyond them. */
static double @f@_excursion(double u)
{
    const double x = fmin(fmax(u, @f@_knots[0]), @f@_knots[@M@_KNOTS_SIZE - 1]);
    const int k = @f@_cell(@f@_knots, @M@_KNOTS_SIZE, x);
    const double t = (x - @f@_knots[k]) / (@f@_knots[k + 1] - @f@_knots[k]);
    const double f0 = @f@_first[2 * k], middle = @f@_first[2 * k + 1], f1 = @f@_first[2 * k + 2];
    return f0 + t * (4 * middle - f1 - 3 * f0 + t * 2 * (f1 - 2 * middle + f0));
}

static double @f@_single(double u)
{
    const int k = @f@_cell(@f@_knots, @M@_KNOTS_SIZE, u);
    const double t = (u - @f@_knots[k]) / (@f@_knots[k + 1] - @f@_knots[k]);
    return @M@_OFFSET + @f@_straight[k] + t * (@f@_straight[k + 1] - @f@_straight[k]) +
           legendre(@f@_b, @M@_B_SIZE, (u - @M@_CENTER) / @M@_HALF);
}

/* The other end of the interval that a first extremum spans. */
static double @f@_opposite(double extremum)
{
    return @M@_INITIAL ? @M@_INITIAL * INFINITY : 2 * @M@_CENTER - extremum;
}

static double @f@_step(const double *s, double u0, double u1, double dt, double *next)
{
    const double *extrema = s + 1, *height = s + 1 + @M@_DEPTH;
    int kept = (int)s[0];
    double y;
    (void)u0;
    (void)dt;
    while (kept > 0) {
        const double last = extrema[kept - 1];
        const double other = kept > 1 ? extrema[kept - 2] : @f@_opposite(extrema[0]);
        if (fmin(last, other) < u1 && u1 < fmax(last, other))
            break;
        kept--;
    }
    if (kept > @M@_DEPTH - 1)
        kept = @M@_DEPTH - 1;
    if (kept == 0)
        y = @M@_REST + @f@_excursion(u1);
    else if (u1 > extrema[kept - 1])
        y = height[kept - 1] + 2 * @f@_everett(u1, extrema[kept - 1]);
    else
        y = height[kept - 1] - 2 * @f@_everett(extrema[kept - 1], u1);
    if (next) {
        if (next != s) {
            int k;
            for (k = 0; k < kept; k++) {
                next[1 + k] = extrema[k];
                next[1 + @M@_DEPTH + k] = height[k];
            }
        }
        next[0] = kept + 1;
        next[1 + kept] = u1;
        next[1 + @M@_DEPTH + kept] = y;
    }
    return y + @f@_single(u1);
}

static void @f@_init(double *s, double u0)
{
    s[0] = 0;
    @f@_step(s, u0, u0, 0.0, s);
}
