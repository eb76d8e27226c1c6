/* MuJoCo's library, shipped next to the FMU's binary.
 *
 * The Windows loader searches the folder of the host's program instead, so the library is loaded by
 * its full path and its functions are looked up. */
#ifndef MUJOCO_LIBRARY_H
#define MUJOCO_LIBRARY_H

#include <mujoco/mujoco.h>
#include <stdbool.h>
#include <stdio.h>

#include "component.h"

/* MuJoCo's headers declare only log handlers of the whole process. */
mjfLogHandler _mjPRIVATE_setTlsLogHandler(mjfLogHandler handler);

#ifdef _WIN32

#include "beside.h"

#define EACH_FUNCTION(F)                                                                           \
    F(mj_copyModel)                                                                                \
    F(mj_deleteData)                                                                               \
    F(mj_deleteModel)                                                                              \
    F(mj_forward)                                                                                  \
    F(mj_getState)                                                                                 \
    F(mj_loadModel)                                                                                \
    F(mj_makeData)                                                                                 \
    F(mj_resetData)                                                                                \
    F(mj_setConst)                                                                                 \
    F(mj_setState)                                                                                 \
    F(mj_stateSize)                                                                                \
    F(mj_step)                                                                                     \
    F(mj_step2)                                                                                    \
    F(mj_version)                                                                                  \
    F(mju_isBad)                                                                                   \
    F(mju_warningText)                                                                             \
    F(_mjPRIVATE_setTlsLogHandler)

#define POINTER(name) static __typeof__(&name) name##_;
EACH_FUNCTION(POINTER)

static bool library_is_there(Message *why) {
    void *library = beside("mujoco.dll");
    bool all = library != NULL;
#define LOOK_UP(name) all = all && look_up(library, #name, &name##_);
    EACH_FUNCTION(LOOK_UP)
    return all ||
           deny(why,
                "mujoco.dll cannot be loaded from the folder of the FMU's binary (error %lu of "
                "Windows); it needs Microsoft's Visual C++ redistributable.",
                GetLastError());
}

#define mj_copyModel mj_copyModel_
#define mj_deleteData mj_deleteData_
#define mj_deleteModel mj_deleteModel_
#define mj_forward mj_forward_
#define mj_getState mj_getState_
#define mj_loadModel mj_loadModel_
#define mj_makeData mj_makeData_
#define mj_resetData mj_resetData_
#define mj_setConst mj_setConst_
#define mj_setState mj_setState_
#define mj_stateSize mj_stateSize_
#define mj_step mj_step_
#define mj_step2 mj_step2_
#define mj_version mj_version_
#define mju_isBad mju_isBad_
#define mju_warningText mju_warningText_
#define _mjPRIVATE_setTlsLogHandler _mjPRIVATE_setTlsLogHandler_

#else

static bool library_is_there(Message *why) {
    (void)why;
    return true;
}

#endif

#endif
