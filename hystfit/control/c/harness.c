/* Reads "u0", then one pair "value dt" a line; forward (argument f) prints y, inverse (argument i) prints u, y and status. */
#include <stdio.h>

#include "@name@.h"

int main(int argc, char **argv)
{
    static @name@ h;
    double u0, value, dt;
    if (argc != 2 || (argv[1][0] != 'f' && (argv[1][0] != 'i' || !@NAME@_INVERTIBLE))) {
        fprintf(stderr, "usage: %s %s < values\n", argv[0], @NAME@_INVERTIBLE ? "f|i" : "f (the model has no inverse)");
        return 2;
    }
    if (scanf("%lf", &u0) != 1)
        return 2;
    @name@_init(&h, u0);
    while (scanf("%lf %lf", &value, &dt) == 2) {
        if (argv[1][0] == 'f') {
            printf("%.17g\n", @name@_step(&h, value, dt));
        } else {
#if @NAME@_INVERTIBLE
            double u;
            const int status = @name@_inverse(&h, value, dt, &u);
            printf("%.17g %.17g %d\n", u, h.y, status);
#endif
        }
    }
    return 0;
}
