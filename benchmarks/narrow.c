/* Makes this processor look as if it had no vectors longer than AVX2 or AVX, to every compiler in a program.
 *
 *     cc -O2 -shared -fPIC -o narrow.so benchmarks/narrow.c -ldl
 *     NARROW=avx2 LD_PRELOAD=./narrow.so program        (a Haswell; NARROW=avx: a Sandy Bridge)
 *
 * The instruction `cpuid` is made to fault, and the handler answers for it; /proc/cpuinfo says the same. Linux on
 * x86-64 only, on processors that can fault (Intel since 2012, AMD since 2021). Instructions are not forbidden: a
 * program that uses them without asking still can.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

enum { ARCH_SET_CPUID = 0x1012 };
enum { HASWELL = 0x306C3, SANDY_BRIDGE = 0x206A7 }; /* family, model and stepping */
enum { NOTHING, AVX, AVX2 };
#define BIT(n) (1u << (n))

static int widest; /* NOTHING: no change */
static struct sigaction ours;

static long answer_by_processor(int yes)
{
    return syscall(SYS_arch_prctl, ARCH_SET_CPUID, (long)yes);
}

/* Intel's manual, volume 2A, CPUID. */
static void narrow(uint32_t leaf, uint32_t part, uint32_t *a, uint32_t *b, uint32_t *c, uint32_t *d)
{
    switch (leaf) {
    case 0: /* the last leaf, and the maker: GenuineIntel */
        if (*a > 13)
            *a = 13;
        *b = 0x756e6547, *d = 0x49656e69, *c = 0x6c65746e;
        break;
    case 1:
        *a = widest == AVX2 ? HASWELL : SANDY_BRIDGE;
        if (widest == AVX)
            *c &= ~(BIT(12) | BIT(22) | BIT(29) | BIT(30)); /* FMA, MOVBE, F16C, RDRAND */
        break;
    case 7:
        *a = *c = *d = 0;
        *b = part == 0 && widest == AVX2 ? *b & (BIT(0) | BIT(3) | BIT(5) | BIT(8) | BIT(9)) : 0; /* BMI, AVX2 */
        break;
    case 13: /* states that are saved: x87, SSE, AVX */
        if (part == 0)
            *a &= 7;
        break;
    case 0x80000001:
        if (widest == AVX)
            *c &= ~BIT(5); /* LZCNT */
        break;
    }
}

static void on_fault(int number, siginfo_t *info, void *context)
{
    greg_t *g = ((ucontext_t *)context)->uc_mcontext.gregs;
    const uint8_t *code = (const uint8_t *)g[REG_RIP];
    uint32_t leaf = g[REG_RAX], part = g[REG_RCX], a, b, c, d;
    (void)number, (void)info;
    if (code[0] != 0x0f || code[1] != 0xa2) { /* not cpuid: a true fault, which happens again without us */
        ours.sa_handler = SIG_DFL, ours.sa_flags = 0;
        sigaction(SIGSEGV, &ours, NULL);
        return;
    }
    answer_by_processor(1);
    __asm__ volatile("cpuid" : "=a"(a), "=b"(b), "=c"(c), "=d"(d) : "a"(leaf), "c"(part));
    answer_by_processor(0);
    narrow(leaf, part, &a, &b, &c, &d);
    g[REG_RAX] = a, g[REG_RBX] = b, g[REG_RCX] = c, g[REG_RDX] = d;
    g[REG_RIP] += 2;
}

__attribute__((constructor)) static void start(void)
{
    const char *asked = getenv("NARROW");
    if (asked == NULL)
        return;
    widest = !strcmp(asked, "avx2") ? AVX2 : !strcmp(asked, "avx") ? AVX : NOTHING;
    if (widest == NOTHING) {
        fprintf(stderr, "narrow: NARROW is %s; expected avx2 or avx\n", asked);
        _exit(2);
    }
    ours.sa_sigaction = on_fault;
    ours.sa_flags = SA_SIGINFO | SA_NODEFER;
    sigaction(SIGSEGV, &ours, NULL);
    if (answer_by_processor(0) != 0) {
        fprintf(stderr, "narrow: this processor or kernel cannot make cpuid fault\n");
        _exit(2);
    }
}

/* Other handlers of SIGSEGV, such as a compiler's, would take ours away. */
int sigaction(int number, const struct sigaction *new, struct sigaction *old)
{
    static int (*libc)(int, const struct sigaction *, struct sigaction *);
    if (libc == NULL)
        libc = dlsym(RTLD_NEXT, "sigaction");
    if (number == SIGSEGV && widest != NOTHING && new != NULL && new != &ours)
        return 0;
    return libc(number, new, old);
}

__sighandler_t signal(int number, __sighandler_t handler)
{
    struct sigaction new = {.sa_handler = handler, .sa_flags = SA_RESTART}, old = {.sa_handler = SIG_DFL};
    return sigaction(number, &new, &old) ? SIG_ERR : old.sa_handler;
}

static int narrow_cpuinfo(void)
{
    const char *said = widest == AVX2 ? "model name\t: narrowed to AVX2\nflags\t\t: sse4_2 avx fma avx2\n"
                                      : "model name\t: narrowed to AVX\nflags\t\t: sse4_2 avx\n";
    int file = memfd_create("cpuinfo", MFD_CLOEXEC);
    if (file >= 0 && (write(file, said, strlen(said)) < 0 || lseek(file, 0, SEEK_SET) < 0))
        return -1;
    return file;
}

int open64(const char *path, int flags, ...)
{
    static int (*libc)(const char *, int, ...);
    va_list rest;
    va_start(rest, flags);
    mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;
    va_end(rest);
    if (widest != NOTHING && !strcmp(path, "/proc/cpuinfo"))
        return narrow_cpuinfo();
    if (libc == NULL)
        libc = dlsym(RTLD_NEXT, "open64");
    return libc(path, flags, mode);
}
