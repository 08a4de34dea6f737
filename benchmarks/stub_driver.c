/* A CUDA driver without a device. It writes the PTX that it is given to FOLDER/<module>.ptx, and a line for each
   launch to FOLDER/launches: module, kernel, blocks, threads of a block, bytes of dynamic shared memory. FOLDER is
   the variable STUB_FOLDER. Nothing runs: memory is the host's and keeps its zeros.

   cc -shared -fPIC -o libcuda.so stub_driver.c */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint32_t u32;
typedef uint64_t u64;
typedef struct { int module; char name[1]; } Function;

static FILE *file(const char *name, const char *mode) {
    char path[4096];
    snprintf(path, sizeof path, "%s/%s", getenv("STUB_FOLDER"), name);
    FILE *f = fopen(path, mode);
    if (!f) { perror(path); exit(1); }
    return f;
}

/* The compute capability of the device that both compilers believe in, times ten. */
static int capability(void) { return atoi(getenv("STUB_CAPABILITY")); }

/* ---- the device: numbers as in the enumeration CUdevice_attribute */
int cuDeviceGetAttribute(int *value, int attribute, int device) {
    switch (attribute) {
    case 1: *value = 1024; break;            /* threads of a block */
    case 8: *value = 48 << 10; break;        /* shared memory of a block */
    case 10: *value = 32; break;             /* threads of a warp */
    case 12: case 82: *value = 65536; break; /* registers of a block, of a multiprocessor */
    case 16: *value = 132; break;            /* multiprocessors */
    case 39: *value = 2048; break;           /* threads of a multiprocessor */
    case 41: *value = 1; break;              /* host and device have one address space */
    case 75: *value = capability() / 10; break;
    case 76: *value = capability() % 10; break;
    case 81: *value = 228 << 10; break;      /* shared memory of a multiprocessor */
    case 97: *value = 227 << 10; break;      /* of a block that asks for it */
    case 106: *value = 32; break;            /* blocks of a multiprocessor */
    case 115: *value = 1; break;             /* memory pools */
    default: *value = 0;
    }
    return 0;
}
int cuDriverGetVersion(int *version) { *version = 12090; return 0; }
int cuDeviceGetCount(int *count) { *count = 1; return 0; }
int cuDeviceGet(int *device, int number) { *device = 0; return 0; }
int cuDeviceGetName(char *name, int size, int device) { snprintf(name, size, "stub"); return 0; }
int cuGetErrorName(int error, const char **name) { *name = "refused by the stub"; return 0; }
int cuGetErrorString(int error, const char **text) { *text = "refused by the stub"; return 0; }

/* ---- programs */
int cuModuleLoadDataEx(void **module, const void *image, u32 count, void *options, void *values) {
    static int modules;
    char name[16];
    snprintf(name, sizeof name, "%d.ptx", ++modules);
    FILE *f = file(name, "w");
    fputs(image, f);
    fclose(f);
    *module = (void *)(intptr_t)modules;
    return 0;
}
int cuModuleLoadData(void **module, const void *image) { return cuModuleLoadDataEx(module, image, 0, 0, 0); }
int cuModuleGetFunction(void **function, void *module, const char *name) {
    Function *made = malloc(sizeof *made + strlen(name));
    made->module = (int)(intptr_t)module;
    strcpy(made->name, name);
    *function = made;
    return 0;
}
int cuLaunchKernel(Function *f, u32 gx, u32 gy, u32 gz, u32 bx, u32 by, u32 bz, u32 shared, void *stream,
                   void **arguments, void **extra) {
    FILE *log = file("launches", "a");
    fprintf(log, "%d %s %u %u %u\n", f->module, f->name, gx * gy * gz, bx * by * bz, shared);
    fclose(log);
    return 0;
}
int cuFuncGetAttribute(int *value, int attribute, void *function) { *value = 32; return 0; }
int cuOccupancyMaxActiveBlocksPerMultiprocessor(int *blocks, void *f, int threads, size_t shared) {
    *blocks = 8;
    return 0;
}

/* ---- memory. Addresses that a kernel should have written are zero, or a small offset to zero. */
static int is_memory(u64 p) { return p >= 1 << 20; }
static int copy(u64 to, u64 from, size_t size) {
    if (is_memory(to) && is_memory(from)) memmove((void *)to, (void *)from, size);
    else if (is_memory(to)) memset((void *)to, 0, size);
    return 0;
}
static int allocate(void **pointer, size_t size) { return (*pointer = calloc(1, size + 64)) ? 0 : 2; }
int cuMemGetInfo_v2(size_t *left, size_t *all) { *left = *all = 8ull << 30; return 0; }
int cuMemAlloc_v2(void **p, size_t size) { return allocate(p, size); }
int cuMemAllocAsync(void **p, size_t size, void *stream) { return allocate(p, size); }
int cuMemAllocManaged(void **p, size_t size, u32 flags) { return allocate(p, size); }
int cuMemAllocHost_v2(void **p, size_t size) { return allocate(p, size); }
int cuMemcpyHtoD_v2(u64 to, u64 from, size_t size) { return copy(to, from, size); }
int cuMemcpyDtoH_v2(u64 to, u64 from, size_t size) { return copy(to, from, size); }
int cuMemcpyDtoD_v2(u64 to, u64 from, size_t size) { return copy(to, from, size); }
int cuMemcpyHtoDAsync_v2(u64 to, u64 from, size_t size, void *stream) { return copy(to, from, size); }
int cuMemcpyDtoHAsync_v2(u64 to, u64 from, size_t size, void *stream) { return copy(to, from, size); }
int cuMemsetD8_v2(u64 to, unsigned char value, size_t size) {
    if (is_memory(to)) memset((void *)to, value, size);
    return 0;
}
int cuMemsetD32_v2(u64 to, u32 value, size_t size) {
    for (size_t i = 0; is_memory(to) && i < size; i++) ((u32 *)to)[i] = value;
    return 0;
}
int cuPointerGetAttribute(void *value, int attribute, u64 pointer) { return 1; } /* no pointer of a device */

/* ---- contexts, streams, events: there is one of each */
#define ONE(name) int name(void **handle) { *handle = (void *)1; return 0; }
ONE(cuDevicePrimaryCtxRetain) ONE(cuCtxCreate_v2) ONE(cuCtxGetCurrent) ONE(cuStreamCreate) ONE(cuEventCreate)
ONE(cuDeviceGetDefaultMemPool)

#define DONE(name) int name(void) { return 0; }
DONE(cuInit) DONE(cuCtxSetCurrent) DONE(cuCtxSetLimit) DONE(cuCtxSynchronize) DONE(cuFuncSetAttribute)
DONE(cuMemFree_v2) DONE(cuMemFreeAsync) DONE(cuMemFreeHost) DONE(cuMemAdvise) DONE(cuMemPoolSetAttribute)
DONE(cuMemPoolTrimTo) DONE(cuStreamDestroy_v2) DONE(cuStreamSynchronize) DONE(cuStreamWaitEvent)
DONE(cuEventDestroy) DONE(cuEventRecord) DONE(cuEventSynchronize)
int cuEventElapsedTime(float *ms, void *begin, void *end) { *ms = 1; return 0; }

/* ---- refused: the compilers look for these names when they start */
#define REFUSED(name) int name(void) { return 801; }
REFUSED(cuExternalMemoryGetMappedBuffer) REFUSED(cuExternalMemoryGetMappedMipmappedArray)
REFUSED(cuImportExternalMemory) REFUSED(cuImportExternalSemaphore) REFUSED(cuMipmappedArrayGetLevel)
REFUSED(cuSignalExternalSemaphoresAsync) REFUSED(cuWaitExternalSemaphoresAsync) REFUSED(cuSurfObjectCreate)
REFUSED(cuGraphAddEmptyNode) REFUSED(cuGraphAddKernelNode) REFUSED(cuGraphAddNode) REFUSED(cuGraphCreate)
REFUSED(cuGraphConditionalHandleCreate) REFUSED(cuGraphDestroy) REFUSED(cuGraphExecDestroy)
REFUSED(cuGraphInstantiate) REFUSED(cuGraphLaunch) REFUSED(cuLinkAddData_v2) REFUSED(cuLinkAddFile_v2)
REFUSED(cuLinkComplete) REFUSED(cuLinkCreate_v2) REFUSED(cuLinkDestroy)
