/* Chipmunk's functions under the names that kernels call them by; a pointer is an i64, a cpVect two doubles. */
#include "chipmunk/chipmunk.h"
#include "chipmunk/chipmunk_unsafe.h"

#define AT(kind, address) ((kind *)(intptr_t)(address))
#define ADDRESS(pointer) ((i64)(intptr_t)(pointer))
#define SPACE(address) AT(cpSpace, address)
#define BODY(address) AT(cpBody, address)
#define SHAPE(address) AT(cpShape, address)
#define JOINT(address) AT(cpConstraint, address)
#define IN static inline

IN vector of(cpVect v) { return (vector){{v.x, v.y}}; }

IN i64 space_new(void) { return ADDRESS(cpSpaceNew()); }
IN void space_free(i64 s) { cpSpaceFree(SPACE(s)); }
IN void space_set_iterations(i64 s, i64 n) { cpSpaceSetIterations(SPACE(s), (int)n); }
IN void space_set_gravity(i64 s, double x, double y) { cpSpaceSetGravity(SPACE(s), cpv(x, y)); }
IN void space_set_collision_slop(i64 s, double m) { cpSpaceSetCollisionSlop(SPACE(s), m); }
IN void space_set_collision_bias(i64 s, double share) { cpSpaceSetCollisionBias(SPACE(s), share); }
IN i64 space_static_body(i64 s) { return ADDRESS(cpSpaceGetStaticBody(SPACE(s))); }
IN i64 space_add_body(i64 s, i64 b) { return ADDRESS(cpSpaceAddBody(SPACE(s), BODY(b))); }
IN i64 space_add_shape(i64 s, i64 c) { return ADDRESS(cpSpaceAddShape(SPACE(s), SHAPE(c))); }
IN i64 space_add_constraint(i64 s, i64 j) { return ADDRESS(cpSpaceAddConstraint(SPACE(s), JOINT(j))); }
IN void space_remove_constraint(i64 s, i64 j) { cpSpaceRemoveConstraint(SPACE(s), JOINT(j)); }
IN void space_step(i64 s, double seconds) { cpSpaceStep(SPACE(s), seconds); }

IN i64 body_new(double mass, double inertia) { return ADDRESS(cpBodyNew(mass, inertia)); }
IN void body_free(i64 b) { cpBodyFree(BODY(b)); }
IN void body_set_centre(i64 b, double x, double y) { cpBodySetCenterOfGravity(BODY(b), cpv(x, y)); }
IN void body_set_angle(i64 b, double angle) { cpBodySetAngle(BODY(b), angle); }
IN void body_set_position(i64 b, double x, double y) { cpBodySetPosition(BODY(b), cpv(x, y)); }
IN void body_push(i64 b, double x, double y, double at_x, double at_y) {
  cpBodyApplyImpulseAtLocalPoint(BODY(b), cpv(x, y), cpv(at_x, at_y));
}
IN void body_set_force(i64 b, double x, double y) { cpBodySetForce(BODY(b), cpv(x, y)); }
IN void body_set_torque(i64 b, double torque) { cpBodySetTorque(BODY(b), torque); }
IN double body_angle(i64 b) { return cpBodyGetAngle(BODY(b)); }
IN double body_angular_velocity(i64 b) { return cpBodyGetAngularVelocity(BODY(b)); }
IN vector body_rotation(i64 b) { return of(cpBodyGetRotation(BODY(b))); }
IN vector body_position(i64 b) { return of(cpBodyGetPosition(BODY(b))); }
IN vector body_velocity(i64 b) { return of(cpBodyGetVelocity(BODY(b))); }
void count_arbiter(cpBody *body, cpArbiter *arbiter, void *counts); /* below: the translated callback */
IN void body_each_arbiter(i64 b, i64 callback, i64 counts) {
  (void)callback;
  cpBodyEachArbiter(BODY(b), count_arbiter, AT(void, counts));
}
IN i64 other_shape(i64 arbiter) {
  cpShape *a, *b;
  cpArbiterGetShapes(AT(cpArbiter, arbiter), &a, &b);
  return ADDRESS(b);
}

IN i64 convex_hull(i64 count, i64 from, i64 to, i64 first, double tolerance) {
  return cpConvexHull((int)count, AT(cpVect, from), AT(cpVect, to), AT(int, first), tolerance);
}
IN i64 polygon_new(i64 b, i64 count, i64 corners, double radius) {
  return ADDRESS(cpPolyShapeNewRaw(BODY(b), (int)count, AT(cpVect, corners), radius));
}
IN void shape_free(i64 c) { cpShapeFree(SHAPE(c)); }
IN void shape_set_friction(i64 c, double friction) { cpShapeSetFriction(SHAPE(c), friction); }
IN void shape_set_filter(i64 c, i64 group, i64 bits) {
  cpShapeSetFilter(SHAPE(c), cpShapeFilterNew((cpGroup)group, (cpBitmask)bits, (cpBitmask)(bits >> 32)));
}
IN void shape_set_collision_type(i64 c, i64 kind) { cpShapeSetCollisionType(SHAPE(c), (cpCollisionType)kind); }
IN i64 shape_collision_type(i64 c) { return (i64)cpShapeGetCollisionType(SHAPE(c)); }

IN i64 motor_new(i64 a, i64 b, double rate) { return ADDRESS(cpSimpleMotorNew(BODY(a), BODY(b), rate)); }
IN void motor_set_rate(i64 j, double rate) { cpSimpleMotorSetRate(JOINT(j), rate); }
IN i64 limit_new(i64 a, i64 b, double low, double high) {
  return ADDRESS(cpRotaryLimitJointNew(BODY(a), BODY(b), low, high));
}
IN i64 pivot_new(i64 a, i64 b, double ax, double ay, double bx, double by) {
  return ADDRESS(cpPivotJointNew2(BODY(a), BODY(b), cpv(ax, ay), cpv(bx, by)));
}
IN void constraint_free(i64 j) { cpConstraintFree(JOINT(j)); }
IN double constraint_impulse(i64 j) { return cpConstraintGetImpulse(JOINT(j)); }
IN void constraint_set_max_force(i64 j, double force) { cpConstraintSetMaxForce(JOINT(j), force); }
IN void constraint_set_max_bias(i64 j, double speed) { cpConstraintSetMaxBias(JOINT(j), speed); }
IN void constraint_set_error_bias(i64 j, double share) { cpConstraintSetErrorBias(JOINT(j), share); }

/* Memory: what a kernel creates lives until the next exported call, what the page keeps for as long as its world. */
static _Alignas(16) char arrays[1 << 20];
static i64 used;
void *new_array(i64 bytes) {
  char *place = arrays + used;
  used += (bytes + 15) & ~15LL;
  if (used > (i64)sizeof arrays)
    __builtin_trap();
  return memset(place, 0, (size_t)bytes);
}
static void reset_arrays(void) { used = 0; }
__attribute__((export_name("keep"))) void *keep(int bytes) { return calloc(1, (size_t)bytes); }
__attribute__((export_name("drop"))) void drop(void *place) { free(place); }
__attribute__((export_name("push"))) void push(const double *in, double *out) {
  (void)out; /* an impulse on a body's centre of mass, by hand */
  cpVect centre = cpBodyLocalToWorld(BODY(in[0]), cpBodyGetCenterOfGravity(BODY(in[0])));
  cpBodyApplyImpulseAtWorldPoint(BODY(in[0]), cpv(in[1], in[2]), centre);
}
void cpMessage(const char *condition, const char *file, int line, int is_error, int is_hard, const char *message, ...) {
  (void)condition, (void)file, (void)line, (void)is_error, (void)message;
  if (is_hard)
    __builtin_trap();
}
