/* What compilers and systems ask for where there is no library of theirs. */

#include <stddef.h>

#if defined(_WIN32)
int __attribute__((stdcall)) DllMainCRTStartup(void *instance, unsigned long reason, void *reserved)
{
    (void)instance, (void)reason, (void)reserved;
    return 1;
}

int _fltused; /* that floating-point numbers are used */
#endif

/* Compilers write calls of these for large values, even where none stands in the source. */
__attribute__((visibility("hidden"))) void *memset(void *to, int value, size_t count)
{
    for (volatile unsigned char *byte = to; count--; byte++) *byte = (unsigned char)value;
    return to;
}

__attribute__((visibility("hidden"))) void *memcpy(void *restrict to, const void *restrict from, size_t count)
{
    const unsigned char *source = from;
    for (volatile unsigned char *byte = to; count--; byte++) *byte = *source++;
    return to;
}
