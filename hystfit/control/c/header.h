/* @title@
 *
 * Made by hystfit @version@. C99, no library beyond math.h, no allocation; all memory is in struct @name@.
 *
 *     @name@ h;
 *     @name@_init(&h, 0.0);                  in equilibrium at an input
 *     y = @name@_step(&h, u, dt);            forward: output for the next input, dt after the last
 *     status = @name@_inverse(&h, y, dt, &u);  inverse: input for the next desired output
 *@obstacle@
 * After each call h.status holds @NAME@_OK or what is wrong. An input that is NaN, infinite or too large for the model's arithmetic changes
 * nothing: the last output is returned, and the status is @NAME@_NOT_FINITE.
 *
 * Input in @u_unit@, output in @y_unit@, dt in s. A struct serves the forward model or the inverse, not both.
 */
#ifndef @NAME@_H
#define @NAME@_H

#define @NAME@_STATES @states@
#define @NAME@_INVERTIBLE @invertible@
/* The inverse holds its input between these, in @u_unit@: @limits@. */
#define @NAME@_LOW @low@
#define @NAME@_HIGH @high@

enum { @NAME@_OK = 0, @NAME@_SATURATED = 1, @NAME@_NOT_MONOTONE = 2, @NAME@_OUT_OF_RANGE = 3, @NAME@_NOT_FINITE = 4 };

typedef struct @name@ {
    double u, y, move;
    int status;
    double state[@NAME@_STATES], before[@NAME@_STATES];
} @name@;

void @name@_init(@name@ *h, double u0);
double @name@_step(@name@ *h, double u, double dt);
#if @NAME@_INVERTIBLE
int @name@_inverse(@name@ *h, double y, double dt, double *u);
#endif

#endif
