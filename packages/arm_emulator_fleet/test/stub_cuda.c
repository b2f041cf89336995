/* NVIDIA's driver as the tests take it: memory is the host's, a module is a shared library.

   Every argument is checked as the driver documents it, and answered with its error codes. Each
   call is noted, with the code that was answered. A kernel NAME of a module is the function of that
   name in the processor's form; a call of it checks that the grid covers the threads. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <link.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cuda_driver.h"

enum { CARDS = 2, MOST_BLOCKS = 4096, DEPTH = 16, NOTES = 1 << 20, GUARD = 64, GUARD_BYTE = 0xa5 };
enum { REGISTERS = 40, LARGEST_BLOCK = 512, DEFAULT_STACK = 1024 };
enum { PARAMETER_BYTES = 4096 };

struct CUctx_st {
  int card;
  size_t limits[3];
};
struct CUmod_st {
  void* library;
};
struct CUfunc_st {
  void (*loop)(int64_t, int64_t, void**);
};
struct block {
  char* at;
  size_t size;
  int card;
};

static struct CUctx_st contexts[CARDS];
static struct block blocks[MOST_BLOCKS];
static __thread CUcontext stack[DEPTH];
static __thread int depth;
static pid_t process;
static size_t memory_size = 64u << 20, in_use;
static char notes[NOTES];
static size_t noted;
static char failing[64];
static CUresult fails_with;
static int cards = CARDS;
static pthread_mutex_t turn = PTHREAD_MUTEX_INITIALIZER;

/* Functions for the tests. */

const char* stub_notes(void) { return notes; }
void stub_forget(void) { notes[noted = 0] = '\0'; }
void stub_set_memory(size_t size) { memory_size = size; }
void stub_set_cards(int count) { cards = count; }
size_t stub_memory_in_use(void) { return in_use; }
int stub_contexts(void) { return depth; }
void stub_push(int card) { stack[depth++] = &contexts[card]; }
int stub_pop(void) { return (int)(stack[--depth] - contexts); }

/* The next call of a function answers with a code. */
void stub_fail(const char* function, int code) {
  snprintf(failing, sizeof failing, "%s", function);
  fails_with = code;
}

static CUresult note(const char* function, CUresult code) {
  pthread_mutex_lock(&turn);
  noted += (size_t)snprintf(notes + noted, NOTES - noted, "%s %d\n", function, code);
  if (noted > NOTES - 256) noted = 0;
  pthread_mutex_unlock(&turn);
  return code;
}

static CUresult take_failure(const char* function) {
  if (strcmp(failing, function) != 0) return 0;
  failing[0] = '\0';
  return fails_with;
}

#define ANSWER(code) return note(__func__, code)
#define CHECK(condition, code) \
  if (!(condition)) ANSWER(code)
#define CHECK_BEGUN()                                     \
  CHECK(process == getpid(), CUDA_ERROR_NOT_INITIALIZED); \
  {                                                       \
    const CUresult failure = take_failure(__func__);      \
    CHECK(!failure, failure);                             \
  }
#define CHECK_CONTEXT() \
  CHECK_BEGUN();        \
  CHECK(depth > 0, CUDA_ERROR_INVALID_CONTEXT)

static CUcontext current(void) { return stack[depth - 1]; }

/* A place of blocks may be taken by another thread as soon as it is left, so threads take turns. */
static pthread_mutex_t blocks_turn = PTHREAD_MUTEX_INITIALIZER;

static struct block* find(CUdeviceptr pointer, size_t size) {
  for (int k = 0; k < MOST_BLOCKS; ++k) {
    const CUdeviceptr at = (CUdeviceptr)(uintptr_t)blocks[k].at;
    if (at && pointer >= at && pointer + size <= at + blocks[k].size) return &blocks[k];
  }
  return NULL;
}

/* Memory of modules is no block; a host address is in neither. */
static int is_valid(CUdeviceptr pointer, size_t size) {
  Dl_info about;
  pthread_mutex_lock(&blocks_turn);
  const struct block* found = find(pointer, size);
  const int card = found ? found->card : -1;
  pthread_mutex_unlock(&blocks_turn);
  if (card >= 0) return card == current()->card;
  return dladdr((void*)(uintptr_t)pointer, &about) != 0;
}

CUresult cuInit(unsigned int flags) {
  CHECK(flags == 0, CUDA_ERROR_INVALID_VALUE);
  CHECK(cards > 0, CUDA_ERROR_NO_DEVICE);
  if (!process) {
    process = getpid();
    for (int k = 0; k < CARDS; ++k) contexts[k].card = k, contexts[k].limits[0] = DEFAULT_STACK;
  }
  CHECK_BEGUN();
  ANSWER(0);
}

CUresult cuGetErrorName(CUresult error, const char** name) {
  static __thread char text[32];
  snprintf(text, sizeof text, "CUDA_ERROR_%d", error);
  *name = text;
  return 0;
}

CUresult cuGetErrorString(CUresult error, const char** text) {
  *text = error < 900 ? "text of the driver" : NULL;
  return error < 900 ? 0 : CUDA_ERROR_INVALID_VALUE;
}

CUresult cuDeviceGetCount(int* count) {
  CHECK_BEGUN();
  *count = cards;
  ANSWER(0);
}

CUresult cuDeviceGet(CUdevice* device, int ordinal) {
  CHECK_BEGUN();
  CHECK(ordinal >= 0 && ordinal < cards, CUDA_ERROR_INVALID_DEVICE);
  *device = ordinal;
  ANSWER(0);
}

CUresult cuDeviceGetName(char* name, int length, CUdevice device) {
  CHECK_BEGUN();
  snprintf(name, (size_t)length, "stub %d", device);
  ANSWER(0);
}

CUresult cuDeviceGetAttribute(int* value, int attribute, CUdevice device) {
  CHECK_BEGUN();
  CHECK(device >= 0 && device < cards, CUDA_ERROR_INVALID_DEVICE);
  switch (attribute) {
    case CU_DEVICE_ATTRIBUTE_MULTIPROCESSOR_COUNT:
      *value = 3;
      break;
    case CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR:
      *value = 9;
      break;
    case CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MINOR:
      *value = 0;
      break;
    default:
      ANSWER(CUDA_ERROR_INVALID_VALUE);
  }
  ANSWER(0);
}

CUresult cuDevicePrimaryCtxRetain(CUcontext* context, CUdevice device) {
  CHECK_BEGUN();
  *context = &contexts[device];
  ANSWER(0);
}

CUresult cuCtxPushCurrent_v2(CUcontext context) {
  CHECK_BEGUN();
  CHECK(context && depth < DEPTH, CUDA_ERROR_INVALID_CONTEXT);
  stack[depth++] = context;
  ANSWER(0);
}

CUresult cuCtxPopCurrent_v2(CUcontext* context) {
  CHECK_CONTEXT();
  *context = stack[--depth];
  ANSWER(0);
}

CUresult cuCtxSetLimit(int limit, size_t value) {
  CHECK_CONTEXT();
  CHECK(limit >= 0 && limit < 3, 215);
  CHECK(value < memory_size, CUDA_ERROR_OUT_OF_MEMORY);
  current()->limits[limit] = value;
  ANSWER(0);
}

CUresult cuCtxGetLimit(size_t* value, int limit) {
  CHECK_CONTEXT();
  CHECK(limit >= 0 && limit < 3, 215);
  *value = current()->limits[limit];
  ANSWER(0);
}

CUresult cuCtxSynchronize(void) {
  CHECK_CONTEXT();
  ANSWER(0);
}

CUresult cuStreamSynchronize(CUstream stream) {
  CHECK_CONTEXT();
  CHECK((uintptr_t)stream <= 2, CUDA_ERROR_INVALID_HANDLE);
  ANSWER(0);
}

static CUresult allocate(CUdeviceptr* pointer, size_t size) {
  if (size > memory_size - in_use) return CUDA_ERROR_OUT_OF_MEMORY;
  int k = 0;
  while (k < MOST_BLOCKS && blocks[k].at) ++k;
  if (k == MOST_BLOCKS) return CUDA_ERROR_OUT_OF_MEMORY;
  char* at = aligned_alloc(256, (256 + size + GUARD + 255) / 256 * 256);
  memset(at, GUARD_BYTE, 256 + size + GUARD); /* on both sides, and the content is any */
  blocks[k] = (struct block){at + 256, size, current()->card};
  in_use += size;
  *pointer = (CUdeviceptr)(uintptr_t)(at + 256);
  return 0;
}

CUresult cuMemAlloc_v2(CUdeviceptr* pointer, size_t size) {
  CHECK_CONTEXT();
  CHECK(pointer && size, CUDA_ERROR_INVALID_VALUE);
  pthread_mutex_lock(&blocks_turn);
  const CUresult result = allocate(pointer, size);
  pthread_mutex_unlock(&blocks_turn);
  ANSWER(result);
}

static CUresult release(CUdeviceptr pointer) {
  struct block* found = find(pointer, 0);
  if (!found || found->at != (char*)(uintptr_t)pointer) return CUDA_ERROR_INVALID_VALUE;
  for (int k = 1; k <= GUARD; ++k) {
    const unsigned char below = (unsigned char)found->at[-k];
    const unsigned char above = (unsigned char)found->at[found->size + (size_t)k - 1];
    if (below != GUARD_BYTE || above != GUARD_BYTE) return CUDA_ERROR_ILLEGAL_ADDRESS;
  }
  in_use -= found->size;
  free(found->at - 256);
  *found = (struct block){0};
  return 0;
}

CUresult cuMemFree_v2(CUdeviceptr pointer) {
  CHECK_CONTEXT();
  pthread_mutex_lock(&blocks_turn);
  const CUresult result = release(pointer);
  pthread_mutex_unlock(&blocks_turn);
  ANSWER(result);
}

CUresult cuMemGetInfo_v2(size_t* available, size_t* total) {
  CHECK_CONTEXT();
  *available = memory_size - in_use;
  *total = memory_size;
  ANSWER(0);
}

CUresult cuMemcpyHtoD_v2(CUdeviceptr target, const void* source, size_t size) {
  CHECK_CONTEXT();
  CHECK(is_valid(target, size) && source, CUDA_ERROR_INVALID_VALUE);
  memcpy((void*)(uintptr_t)target, source, size);
  ANSWER(0);
}

CUresult cuMemcpyDtoH_v2(void* target, CUdeviceptr source, size_t size) {
  CHECK_CONTEXT();
  CHECK(is_valid(source, size) && target, CUDA_ERROR_INVALID_VALUE);
  memcpy(target, (void*)(uintptr_t)source, size);
  ANSWER(0);
}

CUresult cuMemcpyDtoD_v2(CUdeviceptr target, CUdeviceptr source, size_t size) {
  CHECK_CONTEXT();
  CHECK(is_valid(target, size) && is_valid(source, size), CUDA_ERROR_INVALID_VALUE);
  memcpy((void*)(uintptr_t)target, (void*)(uintptr_t)source, size);
  ANSWER(0);
}

CUresult cuMemsetD8_v2(CUdeviceptr pointer, unsigned char byte, size_t size) {
  CHECK_CONTEXT();
  CHECK(is_valid(pointer, size), CUDA_ERROR_INVALID_VALUE);
  memset((void*)(uintptr_t)pointer, byte, size);
  ANSWER(0);
}

CUresult cuPointerGetAttribute(void* value, int attribute, CUdeviceptr pointer) {
  CHECK_CONTEXT();
  CHECK(attribute == CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL, CUDA_ERROR_INVALID_VALUE);
  const struct block* found = find(pointer, 0);
  CHECK(found, CUDA_ERROR_INVALID_VALUE);
  *(int*)value = found->card;
  ANSWER(0);
}

static void* load(const char* image) {
  Elf64_Ehdr header;
  char path[64];
  memcpy(&header, image, sizeof header);
  if (memcmp(header.e_ident, ELFMAG, SELFMAG) != 0) return NULL;
  const int file = memfd_create("module", 0); /* it stays open: its path names the library */
  const size_t size = header.e_shoff + (size_t)header.e_shnum * header.e_shentsize;
  if (write(file, image, size) != (ssize_t)size) return NULL;
  snprintf(path, sizeof path, "/proc/self/fd/%d", file);
  return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}

CUresult cuModuleLoadDataEx(CUmodule* module, const void* image, unsigned int options, int* names,
                            void** values) {
  CHECK_CONTEXT();
  char* log = NULL;
  size_t length = 0;
  for (unsigned int k = 0; k < options; ++k) {
    if (names[k] == CU_JIT_ERROR_LOG_BUFFER) log = values[k];
    if (names[k] == CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES) length = (size_t)(uintptr_t)values[k];
  }
  void* library = strlen(image) < 4 ? NULL : load(image);
  if (!library && log) snprintf(log, length, "ptxas application ptx input, line 1; fatal: no PTX");
  CHECK(library, CUDA_ERROR_INVALID_PTX);
  *module = malloc(sizeof **module);
  (*module)->library = library;
  ANSWER(0);
}

CUresult cuModuleUnload(CUmodule module) {
  CHECK_CONTEXT();
  CHECK(module && module->library, CUDA_ERROR_INVALID_HANDLE);
  module->library = NULL;
  ANSWER(0);
}

CUresult cuModuleGetFunction(CUfunction* function, CUmodule module, const char* name) {
  CHECK_CONTEXT();
  CHECK(module && module->library, CUDA_ERROR_INVALID_HANDLE);
  void* found = dlsym(module->library, name);
  CHECK(found, CUDA_ERROR_NOT_FOUND);
  *function = calloc(1, sizeof **function);
  memcpy(&(*function)->loop, &found, sizeof found);
  ANSWER(0);
}

CUresult cuModuleGetGlobal_v2(CUdeviceptr* pointer, size_t* size, CUmodule module,
                              const char* name) {
  CHECK_CONTEXT();
  CHECK(module && module->library, CUDA_ERROR_INVALID_HANDLE);
  void* found = dlsym(module->library, name);
  CHECK(found, CUDA_ERROR_NOT_FOUND);
  Dl_info about;
  ElfW(Sym)* symbol = NULL;
  dladdr1(found, &about, (void**)&symbol, RTLD_DL_SYMENT);
  *pointer = (CUdeviceptr)(uintptr_t)found;
  *size = symbol->st_size;
  ANSWER(0);
}

CUresult cuFuncGetAttribute(int* value, int attribute, CUfunction function) {
  CHECK_CONTEXT();
  CHECK(function, CUDA_ERROR_INVALID_HANDLE);
  switch (attribute) {
    case CU_FUNC_ATTRIBUTE_NUM_REGS:
      *value = REGISTERS;
      break;
    case CU_FUNC_ATTRIBUTE_MAX_THREADS_PER_BLOCK:
      *value = LARGEST_BLOCK;
      break;
    case CU_FUNC_ATTRIBUTE_LOCAL_SIZE_BYTES:
      *value = 16;
      break;
    case CU_FUNC_ATTRIBUTE_SHARED_SIZE_BYTES:
      *value = 0;
      break;
    default:
      ANSWER(CUDA_ERROR_INVALID_VALUE);
  }
  ANSWER(0);
}

CUresult cuLaunchKernel(CUfunction function, unsigned int grid_x, unsigned int grid_y,
                        unsigned int grid_z, unsigned int block_x, unsigned int block_y,
                        unsigned int block_z, unsigned int shared, CUstream stream,
                        void** parameters, void** extra) {
  CHECK_CONTEXT();
  CHECK(function, CUDA_ERROR_INVALID_HANDLE);
  CHECK(grid_x && grid_y == 1 && grid_z == 1 && block_x, CUDA_ERROR_INVALID_VALUE);
  CHECK(block_y == 1 && block_z == 1 && !shared && !extra && !stream, CUDA_ERROR_INVALID_VALUE);
  CHECK(block_x <= LARGEST_BLOCK, 701);
  int64_t threads;
  memcpy(&threads, parameters[0], sizeof threads);
  const int64_t covered = (int64_t)grid_x * block_x;
  CHECK(threads > covered - (int64_t)block_x && threads <= covered, CUDA_ERROR_ILLEGAL_ADDRESS);
  function->loop(0, threads, parameters + 1);
  ANSWER(0);
}
