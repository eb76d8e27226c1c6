/* Libraries in the folder of this one, on Windows. */
#ifndef BESIDE_H
#define BESIDE_H

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

static const char here = 0; /* an address in this library */

/* Many names of the Windows headers clash with others. */
#define WIN32_LEAN_AND_MEAN
#define NOGDI
#define NOUSER
#include <windows.h>

/* The full path lets Windows find dependencies next to the library. */
static void *beside(const char *name) {
    wchar_t path[4096];
    HMODULE own = NULL;
    const size_t room = sizeof path / sizeof path[0];
    const DWORD how =
        GET_MODULE_HANDLE_EX_FLAG_FROM_ADDRESS | GET_MODULE_HANDLE_EX_FLAG_UNCHANGED_REFCOUNT;
    if (!GetModuleHandleExW(how, (const wchar_t *)&here, &own)) {
        return NULL;
    }
    const size_t length = GetModuleFileNameW(own, path, (DWORD)room);
    wchar_t *end = length < room ? wcsrchr(path, L'\\') : NULL;
    if (!end || (size_t)(end - path) + strlen(name) + 2 > room) {
        return NULL;
    }
    do {
        *++end = (wchar_t)*name; /* library names are ASCII */
    } while (*name++);
    return LoadLibraryExW(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
}

/* Store a function's address; false if the library lacks it. */
static bool look_up(void *library, const char *name, void *pointer) {
    const FARPROC found = GetProcAddress(library, name);
    memcpy(pointer, &found, sizeof found);
    return found != NULL;
}

#endif
