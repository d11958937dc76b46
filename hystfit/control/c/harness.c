/* Reads "u0", then one pair "value dt" a line; forward (argument f) prints y, inverse (argument i) prints u, y and status. */
#include <stdio.h>

#include "@name@.h"

int main(int argc, char **argv)
{
    static @name@ h;
    double u0, value, dt, u;
    if (argc != 2 || (argv[1][0] != 'f' && argv[1][0] != 'i')) {
        fprintf(stderr, "usage: %s f|i < values\n", argv[0]);
        return 2;
    }
    if (scanf("%lf", &u0) != 1)
        return 2;
    @name@_init(&h, u0);
    while (scanf("%lf %lf", &value, &dt) == 2) {
        if (argv[1][0] == 'f') {
            printf("%.17g\n", @name@_step(&h, value, dt));
        } else {
            const int status = @name@_inverse(&h, value, dt, &u);
            printf("%.17g %.17g %d\n", u, h.y, status);
        }
    }
    return 0;
}
