/* Thread-local storage directory for the Windows loader, for binaries without a C library's start-
 * up code. */
#include <windows.h>

ULONG _tls_index;
__attribute__((section(".tls"))) char *_tls_start;
__attribute__((section(".tls$ZZZ"))) char *_tls_end;
__attribute__((section(".CRT$XLA"))) PIMAGE_TLS_CALLBACK first;
__attribute__((section(".CRT$XLZ"))) PIMAGE_TLS_CALLBACK last;

const IMAGE_TLS_DIRECTORY _tls_used = {
    .StartAddressOfRawData = (ULONG_PTR)&_tls_start,
    .EndAddressOfRawData = (ULONG_PTR)&_tls_end,
    .AddressOfIndex = (ULONG_PTR)&_tls_index,
    .AddressOfCallBacks = (ULONG_PTR)(&first + 1),
};
