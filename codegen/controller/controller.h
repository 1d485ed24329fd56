/* Joint torques from encoders and a reference, once a period: computed torque, or adaptive.
 *
 * An example of a program that uses an exported arm. Nothing is allocated: the caller owns a
 * `controller`. Arrays have one element per joint, in the order of arm.h; SI units.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Parameters that adapt: link parameters, then effect coefficients, as in arm.h. */
#define CONTROLLER_PARAMETERS (ARM_LINK_PARAMETERS + ARM_EFFECT_COEFFICIENTS)

enum { COMPUTED_TORQUE = 0, SLOTINE_LI = 1 };

typedef struct {
    double q[ARM_JOINTS], dq[ARM_JOINTS], ddq[ARM_JOINTS];
} controller_reference;

typedef struct {
    int law;                      /* COMPUTED_TORQUE or SLOTINE_LI */
    double period;                /* s, from cycle to cycle */
    double bandwidth;             /* 1/s: both laws place a double pole there */
    double adaptation;            /* gain of SLOTINE_LI on sizes squared; 0: no adaptation */
    double smooth_velocity[ARM_JOINTS]; /* half width of the smooth sign of friction, rad/s or m/s */
    double sizes[CONTROLLER_PARAMETERS]; /* how far each parameter may be off, in its unit */
} controller_settings;

typedef struct {
    controller_settings settings;
    arm_state state;                          /* memory of the arm's effects */
    double cycles;                            /* so far */
    double q_before[ARM_JOINTS];              /* encoders one cycle ago */
    double damping[ARM_JOINTS];               /* of SLOTINE_LI */
    double parameters[CONTROLLER_PARAMETERS]; /* of SLOTINE_LI: the estimate so far */
} controller;

/* Bytes of a controller, for callers that cannot read this header. */
int controller_size(void);

/* Start at rest at q; the adaptive law starts from the exported parameters. */
void controller_begin(controller *c, const controller_settings *settings, const double *q);

/* One cycle: encoders q in, torques out. Returns the time it took by the clock, s: without a
 * real-time kernel that is, now and then, another program's time. */
double controller_cycle(controller *c, const controller_reference *reference, const double *q,
    double *torque);

/* The two laws; dq is the velocity by the encoders. */
void computed_torque(controller *c, const controller_reference *reference, const double *q,
    const double *dq, double *torque);
void slotine_li(controller *c, const controller_reference *reference, const double *q,
    const double *dq, double *torque);

#ifdef __cplusplus
}
#endif

#endif
