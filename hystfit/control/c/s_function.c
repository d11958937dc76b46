/* Level-2 C MEX S-function of @name@ for Simulink: one input (@u_unit@), one output (@y_unit@), the parameters of the fit inside.
 *
 *     mex @name@_sfun.c @name@.c
 *
 * Made by hystfit @version@. The state is in DWork, so that several blocks, resets and code generation work. The output is computed from a copy
 * of the state, which advances once per major time step.
 */
#define S_FUNCTION_NAME @name@_sfun
#define S_FUNCTION_LEVEL 2

#include "simstruc.h"

#include "@name@.h"

enum { MODEL = 0, CLOCK = 1, LAST = 0, STARTED = 1 }; /* DWork vectors; elements of CLOCK */

static void mdlInitializeSizes(SimStruct *S)
{
    ssSetNumSFcnParams(S, 0);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S))
        return;
    ssSetNumContStates(S, 0);
    ssSetNumDiscStates(S, 0);
    if (!ssSetNumInputPorts(S, 1) || !ssSetNumOutputPorts(S, 1))
        return;
    ssSetInputPortWidth(S, 0, 1);
    ssSetInputPortRequiredContiguous(S, 0, 1);
    ssSetInputPortDirectFeedThrough(S, 0, 1);
    ssSetOutputPortWidth(S, 0, 1);
    ssSetNumSampleTimes(S, 1);
    ssSetNumDWork(S, 2);
    ssSetDWorkWidth(S, MODEL, (int_T)(sizeof(@name@) / sizeof(double))); /* the struct holds doubles only */
    ssSetDWorkDataType(S, MODEL, SS_DOUBLE);
    ssSetDWorkWidth(S, CLOCK, 2);
    ssSetDWorkDataType(S, CLOCK, SS_DOUBLE);
    ssSetOptions(S, SS_OPTION_EXCEPTION_FREE_CODE);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, INHERITED_SAMPLE_TIME);
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_INITIALIZE_CONDITIONS
static void mdlInitializeConditions(SimStruct *S)
{
    double *clock = (double *)ssGetDWork(S, CLOCK);
    clock[STARTED] = 0.0; /* the device is in equilibrium at the first input */
}

static double advanced(SimStruct *S, @name@ *h)
{
    const double *clock = (const double *)ssGetDWork(S, CLOCK);
    const double u = ssGetInputPortRealSignal(S, 0)[0];
    if (clock[STARTED] != 0.0)
        return @name@_step(h, u, ssGetT(S) - clock[LAST]);
    @name@_init(h, u);
    return @name@_step(h, u, 0.0);
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    @name@ copy = *(const @name@ *)ssGetDWork(S, MODEL);
    UNUSED_ARG(tid);
    ssGetOutputPortRealSignal(S, 0)[0] = advanced(S, &copy);
}

#define MDL_UPDATE
static void mdlUpdate(SimStruct *S, int_T tid)
{
    double *clock = (double *)ssGetDWork(S, CLOCK);
    UNUSED_ARG(tid);
    advanced(S, (@name@ *)ssGetDWork(S, MODEL));
    clock[LAST] = ssGetT(S);
    clock[STARTED] = 1.0;
}

static void mdlTerminate(SimStruct *S)
{
    UNUSED_ARG(S);
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
