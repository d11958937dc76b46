void @name@_init(@name@ *h, double u0)
{
    if (!isfinite(u0))
        u0 = 0;
    @root@_init(h->state, u0);
    h->u = u0;
    h->move = 0;
    h->y = @root@_step(h->state, u0, u0, 0.0, 0);
    h->status = isfinite(h->y) ? @NAME@_OK : @NAME@_NOT_FINITE;
}

double @name@_step(@name@ *h, double u, double dt)
{
    int k, whole;
    double y;
    h->status = @NAME@_NOT_FINITE;
    if (!isfinite(u) || !isfinite(dt))
        return h->y;
    for (k = 0; k < @NAME@_STATES; k++)
        h->before[k] = h->state[k];
    y = @root@_step(h->state, h->u, u, dt, h->state);
    whole = isfinite(y);
    for (k = 0; k < @NAME@_STATES; k++)
        whole = whole && !isnan(h->state[k]);
    if (!whole) {
        for (k = 0; k < @NAME@_STATES; k++)
            h->state[k] = h->before[k];
        return h->y;
    }
    h->status = @NAME@_OK;
    h->y = y;
    h->move = fabs(u - h->u);
    h->u = u;
    return h->y;
}

#if @NAME@_INVERTIBLE
static double @name@_miss(const @name@ *h, double u, double dt, double y)
{
    return @NAME@_SIGN * (@root@_step(h->state, h->u, u, dt, 0) - y);
}

/* Chandrupatla's search between a and b, whose values fa and fb differ in sign: at most 100 steps, about 8 as a rule. */
static double @name@_search(const @name@ *h, double dt, double y, double a, double fa, double b, double fb)
{
    double t = 0.5, best = a;
    int k;
    for (k = 0; k < 100; k++) {
        const double x = a + t * (b - a), fx = @name@_miss(h, x, dt, y);
        double c = b, fc = fb, least, limit, xi, phi;
        if ((fx < 0) == (fa < 0)) {
            c = a;
            fc = fa;
        } else {
            b = a;
            fb = fa;
        }
        a = x;
        fa = fx;
        best = fabs(fa) < fabs(fb) ? a : b;
        least = fabs(fa) < fabs(fb) ? fabs(fa) : fabs(fb);
        limit = (2 * DBL_EPSILON * fabs(best) + DBL_MIN) / fabs(b - c);
        if (least == 0 || limit > 0.5 || fabs(b - a) <= 2 * DBL_EPSILON * fabs(best))
            break;
        xi = (a - b) / (c - b);
        phi = (fa - fb) / (fc - fb);
        t = 0.5;
        if (phi * phi < xi && (1 - phi) * (1 - phi) < 1 - xi)
            t = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb);
        t = fmin(1 - limit, fmax(limit, t));
    }
    return best;
}

int @name@_inverse(@name@ *h, double y, double dt, double *u)
{
    const double edge_low = @NAME@_LOW, edge_high = @NAME@_HIGH;
    const double from = fmin(fmax(h->u, edge_low), edge_high);
    double here, probe, value, side, stride, answer = from;
    int rising = 1, found = 0, status = @NAME@_OK;
    if (!isfinite(dt)) {
        *u = from;
        h->status = @NAME@_NOT_FINITE;
        return @NAME@_NOT_FINITE;
    }
    if (!isfinite(y)) {
        *u = from;
        @name@_step(h, from, dt);
        return @NAME@_OUT_OF_RANGE;
    }
    here = @name@_miss(h, from, dt, y);
    side = here < 0 ? 1.0 : -1.0;
    if (here == 0) {
        found = 1;
    } else {
        double near = from, at_near = here;
        stride = fmax(fmax(2 * h->move, 1e-6 * @NAME@_SCALE), 1e-9 * fabs(from));
        probe = from + side * 1e-7 * @NAME@_SCALE;
        while (!found) {
            probe = fmin(fmax(probe, edge_low), edge_high);
            if (probe == near)
                break;
            value = @name@_miss(h, probe, dt, y);
            if (side * (value - at_near) < 0)
                rising = 0;
            if ((value < 0) != (here < 0)) {
                answer = @name@_search(h, dt, y, near, at_near, probe, value);
                found = 1;
            } else {
                if (rising)
                    answer = probe;
                near = probe;
                at_near = value;
                probe = from + side * stride;
                stride *= 4;
            }
            if (fabs(probe) > 1e300)
                break;
        }
    }
    *u = answer;
    @name@_step(h, answer, dt);
    if (!rising)
        status = @NAME@_NOT_MONOTONE;
    else if (!(fabs(h->y - y) <= @NAME@_TOLERANCE))
        status = @NAME@_OUT_OF_RANGE;
    if (@NAME@_GIVEN && !(fabs(h->y - y) <= @NAME@_TOLERANCE) && (answer == edge_low || answer == edge_high))
        status = @NAME@_SATURATED;
    h->status = status;
    return status;
}
#endif
