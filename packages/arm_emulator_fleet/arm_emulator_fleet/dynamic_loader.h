/* Functions of the system's loader, as <dlfcn.h>, <link.h> and <elf.h> of glibc declare them. */
#ifndef ARM_DYNAMIC_LOADER_H
#define ARM_DYNAMIC_LOADER_H

#include <stdint.h>

enum { RTLD_NOW = 2, RTLD_DL_SYMENT = 1 };

typedef struct {
  const char* dli_fname;
  void* dli_fbase;
  const char* dli_sname;
  void* dli_saddr;
} Dl_info;

typedef struct {
  uint32_t st_name;
  unsigned char st_info;
  unsigned char st_other;
  uint16_t st_shndx;
  uint64_t st_value;
  uint64_t st_size; /* bytes */
} Elf64_Sym;

void* dlopen(const char* file, int flags);
int dlclose(void* library);
void* dlsym(void* library, const char* name);
char* dlerror(void);
int dladdr1(const void* address, Dl_info* about, void** extra, int flags);

#endif
