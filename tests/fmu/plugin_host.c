/* A host in plain C that times the plug-in of a friction law in MuJoCo.
 *
 *     host PLUGIN SCENE STEPS     print how long all instances take in a step [ns]
 *
 * Speeds are those of host.c; the rest of MuJoCo's step is not timed. */
#include <mujoco/mujoco.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "motion.h"

int main(int count, char **argument) {
    char error[500] = "usage";
    if (count < 4) {
        return 1;
    }
    mj_loadPluginLibrary(argument[1]);
    mjModel *m = mj_loadXML(argument[2], NULL, error, sizeof error);
    mjData *d = m ? mj_makeData(m) : NULL;
    if (!d) {
        fprintf(stderr, "%s\n", error);
        return 1;
    }
    const mjpPlugin *plugin = mjp_getPluginAtSlot(m->plugin[0]);
    const int steps = atoi(argument[3]);
    double seconds = 0.0;
    mj_forward(m, d);
    for (int k = 0; k < steps; k++) {
        for (int i = 0; i < m->nv; i++) {
            d->qvel[i] = 1.2 * bent_triangle(k, i);
        }
        const clock_t start = clock();
        for (int n = 0; n < 100; n++) {
            for (int i = 0; i < m->nplugin; i++) {
                plugin->compute(m, d, i, mjPLUGIN_PASSIVE);
            }
            for (int i = 0; i < m->nplugin; i++) {
                plugin->advance(m, d, i);
            }
        }
        seconds += (double)(clock() - start) / CLOCKS_PER_SEC;
    }
    printf("%.1f\n", seconds / steps / 100 * 1e9);
    return 0;
}
