/* Component: torque of a rigid-body motion by the recursive Newton-Euler algorithm.
 *
 * The torque is linear in first moments and in inertias about the joint frames, so identified base
 * parameters suffice, with zero masses for dependent ones. The generated tree.h describes the
 * joints. */
#include <math.h>

#include "component_alone.h"
#include "component_plain.h"
#include "tree.h"

typedef struct {
    double x, y, z;
} Vector;

static Vector vector(const double *v) {
    return (Vector){v[0], v[1], v[2]};
}

static Vector sum(Vector a, Vector b) {
    return (Vector){a.x + b.x, a.y + b.y, a.z + b.z};
}

static Vector scaled(double s, Vector a) {
    return (Vector){s * a.x, s * a.y, s * a.z};
}

static double dot(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static Vector cross(Vector a, Vector b) {
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* Rotate a vector about a unit axis (Rodrigues' formula). */
static Vector turned(Vector axis, double c, double s, Vector a) {
    return sum(sum(scaled(c, a), scaled(s, cross(axis, a))),
               scaled((1.0 - c) * dot(axis, a), axis));
}

static Vector times(const double *m, Vector a) {
    return (Vector){dot(vector(m), a), dot(vector(m + 3), a), dot(vector(m + 6), a)};
}

static Vector times_transposed(const double *m, Vector a) {
    return sum(sum(scaled(a.x, vector(m)), scaled(a.y, vector(m + 3))), scaled(a.z, vector(m + 6)));
}

typedef struct {
    double cosine, sine; /* of the joint angle */
    Vector position;     /* in the parent frame */
    Vector speed, turn, acceleration, force, moment;
} Link;

static Vector to_parent(const Joint *joint, const Link *link, Vector a) {
    return times(joint->rotation, turned(vector(joint->axis), link->cosine, link->sine, a));
}

static Vector from_parent(const Joint *joint, const Link *link, Vector a) {
    return turned(vector(joint->axis), link->cosine, -link->sine,
                  times_transposed(joint->rotation, a));
}

/* Force and moment of a link's own motion. Its parameters are the mass, the first moments and the
 * inertia xx, xy, yy, xz, yz, zz about its frame. */
static void own_needs(Link *link, const double *p) {
    const double inertia[] = {p[4], p[5], p[7], p[5], p[6], p[8], p[7], p[8], p[9]};
    const Vector moments = vector(p + 1), w = link->speed;
    link->force = sum(scaled(p[0], link->acceleration),
                      sum(cross(link->turn, moments), cross(w, cross(w, moments))));
    link->moment = sum(sum(times(inertia, link->turn), cross(w, times(inertia, w))),
                       cross(moments, link->acceleration));
}

/* Motion of a link's joint, from that of the robot's joints. */
static double followed(const double *motion, int i) {
    double sum_of_leaders = 0.0;
    for (int j = 0; j < JOINTS; j++) {
        sum_of_leaders += slopes[i][j] * motion[j];
    }
    return FOLLOW ? sum_of_leaders : motion[i];
}

static void move_link(const double *v, int i, Link *links) {
    static const Link base = {.acceleration = {-GRAVITY_X, -GRAVITY_Y, -GRAVITY_Z}};
    const Joint *joint = &joints[i];
    const Link *parent = joint->parent < 0 ? &base : &links[joint->parent];
    const Vector axis = vector(joint->axis);
    const double q = followed(&v[POSITION], i) + (FOLLOW ? offsets[i] : 0.0);
    const double dq = followed(&v[VELOCITY], i), ddq = followed(&v[ACCELERATION], i);
    Link *link = &links[i];
    link->cosine = joint->prismatic ? 1.0 : cos(q);
    link->sine = joint->prismatic ? 0.0 : sin(q);
    link->position = vector(joint->translation);
    if (joint->prismatic) {
        link->position = sum(link->position, times(joint->rotation, scaled(q, axis)));
    }
    const Vector w = parent->speed, arm = link->position;
    const Vector carried =
        sum(parent->acceleration, sum(cross(parent->turn, arm), cross(w, cross(w, arm))));
    link->speed = from_parent(joint, link, w);
    link->turn = from_parent(joint, link, parent->turn);
    link->acceleration = from_parent(joint, link, carried);
    if (joint->prismatic) {
        link->acceleration = sum(
            link->acceleration, sum(scaled(ddq, axis), scaled(2.0 * dq, cross(link->speed, axis))));
    } else {
        link->turn = sum(link->turn, sum(scaled(ddq, axis), scaled(dq, cross(link->speed, axis))));
        link->speed = sum(link->speed, scaled(dq, axis));
    }
    own_needs(link, &v[PARAMETERS + 10 * i]);
}

/* Torque of the rotors on joint i; if COUPLED, motors turn with several joints. */
static double rotors_on(const double *v, int i) {
    double torque = 0.0;
    if (!COUPLED) {
        return v[ROTORS + i] * v[ACCELERATION + i];
    }
    for (int k = 0; k < JOINTS; k++) {
        double turn = 0.0;
        for (int j = 0; j < JOINTS; j++) {
            turn += motors[k][j] * v[ACCELERATION + j];
        }
        torque += motors[k][i] * v[ROTORS + k] * turn;
    }
    return torque;
}

/* Torque of the springs and balancers of joint i. */
static double springs_on(const double *v, int i) {
    double torque = 0.0;
    for (int k = 0; k < TERMS; k++) {
        const Spring *spring = &springs[k];
        const double q = v[POSITION + i], angle = spring->harmonic * q;
        if (spring->joint == i) {
            const double wave = spring->sine ? sin(angle) : cos(angle);
            torque += v[ROTORS + JOINTS + k] * (spring->linear ? q : wave);
        }
    }
    return torque;
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)component, (void)workspace, (void)why;
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    double *v = component->v;
    Link links[LINKS];
    double needed[LINKS];
    (void)workspace, (void)why;
    for (int i = 0; i < LINKS; i++) {
        move_link(v, i, links);
    }
    for (int i = LINKS - 1; i >= 0; i--) {
        const Joint *joint = &joints[i];
        const Link *link = &links[i];
        const Vector axis = vector(joint->axis);
        needed[i] = dot(axis, joint->prismatic ? link->force : link->moment);
        if (joint->parent >= 0) {
            Link *parent = &links[joint->parent];
            const Vector force = to_parent(joint, link, link->force);
            parent->force = sum(parent->force, force);
            parent->moment = sum(parent->moment, sum(to_parent(joint, link, link->moment),
                                                     cross(link->position, force)));
        }
    }
    for (int i = 0; i < JOINTS; i++) {
        double torque = FOLLOW ? 0.0 : needed[i];
        for (int k = 0; FOLLOW && k < LINKS; k++) {
            torque += slopes[k][i] * needed[k];
        }
        v[TORQUE + i] = torque + rotors_on(v, i) + springs_on(v, i);
    }
    return true;
}

static bool component_step(Component *component, void *workspace, double step, Message *why) {
    (void)step; /* no states */
    return component_output(component, workspace, why);
}
