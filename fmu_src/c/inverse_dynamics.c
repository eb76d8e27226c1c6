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
    double x;
    double y;
    double z;
} Vector;

/* Three numbers as a vector. */
static Vector vector(const double *v) {
    return (Vector){v[0], v[1], v[2]};
}

static Vector sum(Vector a, Vector b) {
    return (Vector){a.x + b.x, a.y + b.y, a.z + b.z};
}

static Vector scale(double s, Vector a) {
    return (Vector){s * a.x, s * a.y, s * a.z};
}

static double dot(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static Vector cross(Vector a, Vector b) {
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* Rotate a vector about a unit axis by an angle with cosine c and sine s (Rodrigues' formula). */
static Vector rotate(Vector axis, double c, double s, Vector a) {
    return sum(sum(scale(c, a), scale(s, cross(axis, a))), scale((1.0 - c) * dot(axis, a), axis));
}

/* Product of a matrix (3, 3) and a vector. */
static Vector times(const double *m, Vector a) {
    return (Vector){dot(vector(m), a), dot(vector(m + 3), a), dot(vector(m + 6), a)};
}

/* Product of the transpose of a matrix (3, 3) and a vector. */
static Vector times_transposed(const double *m, Vector a) {
    return sum(sum(scale(a.x, vector(m)), scale(a.y, vector(m + 3))), scale(a.z, vector(m + 6)));
}

/* Motion of a link, force and moment on it, in its frame. */
typedef struct {
    double cosine; /* of the joint angle */
    double sine;
    Vector position;     /* in the parent frame */
    Vector speed;        /* angular velocity */
    Vector turn;         /* angular acceleration */
    Vector acceleration; /* less that of gravity */
    Vector force;
    Vector moment;
} Link;

/* A vector of a link's frame in that of its parent. */
static Vector to_parent(const Joint *joint, const Link *link, Vector a) {
    return times(joint->rotation, rotate(vector(joint->axis), link->cosine, link->sine, a));
}

/* A vector of the parent's frame in that of the link. */
static Vector from_parent(const Joint *joint, const Link *link, Vector a) {
    return rotate(vector(joint->axis), link->cosine, -link->sine,
                  times_transposed(joint->rotation, a));
}

/* Set force and moment of a link's own motion. Its parameters are the mass, the first moments and
 * the inertia xx, xy, yy, xz, yz, zz about its frame. */
static void set_force(Link *link, const double *p) {
    const double inertia[] = {p[4], p[5], p[7], p[5], p[6], p[8], p[7], p[8], p[9]};
    const Vector moments = vector(p + 1), w = link->speed;
    link->force = sum(scale(p[0], link->acceleration),
                      sum(cross(link->turn, moments), cross(w, cross(w, moments))));
    link->moment = sum(sum(times(inertia, link->turn), cross(w, times(inertia, w))),
                       cross(moments, link->acceleration));
}

/* Motion of a link's joint, from that of the robot's joints. */
static double joint_motion(const double *motion, int i) {
    double sum_of_leaders = 0.0;
    for (int j = 0; j < JOINTS; j++) {
        sum_of_leaders += slopes[i][j] * motion[j];
    }
    return FOLLOW ? sum_of_leaders : motion[i];
}

/* Set the motion of link i from that of its parent, and its own force and moment. */
static void move_link(const double *v, int i, Link *links) {
    static const Link base = {.acceleration = {-GRAVITY_X, -GRAVITY_Y, -GRAVITY_Z}};
    const Joint *joint = &joints[i];
    const Link *parent = joint->parent < 0 ? &base : &links[joint->parent];
    const Vector axis = vector(joint->axis);
    const double offset = FOLLOW ? offsets[i] : 0.0;
    const double q = joint_motion(&v[POSITION], i) + offset;
    const double dq = joint_motion(&v[VELOCITY], i);
    const double ddq = joint_motion(&v[ACCELERATION], i);
    Link *link = &links[i];
    link->cosine = joint->prismatic ? 1.0 : cos(q);
    link->sine = joint->prismatic ? 0.0 : sin(q);
    link->position = vector(joint->translation);
    if (joint->prismatic) {
        link->position = sum(link->position, times(joint->rotation, scale(q, axis)));
    }
    const Vector w = parent->speed;
    const Vector arm = link->position;
    const Vector carried =
        sum(parent->acceleration, sum(cross(parent->turn, arm), cross(w, cross(w, arm))));
    link->speed = from_parent(joint, link, w);
    link->turn = from_parent(joint, link, parent->turn);
    link->acceleration = from_parent(joint, link, carried);
    if (joint->prismatic) {
        link->acceleration = sum(link->acceleration,
                                 sum(scale(ddq, axis), scale(2.0 * dq, cross(link->speed, axis))));
    } else {
        link->turn = sum(link->turn, sum(scale(ddq, axis), scale(dq, cross(link->speed, axis))));
        link->speed = sum(link->speed, scale(dq, axis));
    }
    set_force(link, &v[PARAMETERS + 10 * i]);
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
        const double q = v[POSITION + i];
        const double angle = spring->harmonic * q;
        if (spring->joint == i) {
            const double wave = spring->sine ? sin(angle) : cos(angle);
            const double shape = spring->linear ? q : wave;
            torque += v[ROTORS + JOINTS + k] * shape;
        }
    }
    return torque;
}

static bool component_initialise(Component *component, void *workspace, Message *why) {
    (void)component;
    (void)workspace;
    (void)why;
    return true;
}

static bool component_output(Component *component, void *workspace, Message *why) {
    double *v = component->v;
    Link links[LINKS];
    double needed[LINKS];
    (void)workspace;
    (void)why;
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
