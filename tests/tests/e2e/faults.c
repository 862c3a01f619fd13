/* An OpenCL layer (cl_loader_layers) that makes the device fail: loaded by the OpenCL loader between the server and the driver.
 *
 * DEVICE_FAULT: a file that says what fails from now on; without it nothing does.
 *   "lost"    all that was opened before fails for ever; the device can be opened again at once. The file is removed.
 *   "spoiled" as "lost", but nothing can be opened any more in this process, as with NVIDIA's driver. The file is removed.
 *   "gone"    as "lost", and the device cannot be opened as long as the file is there.
 *   "fail"    the next launch of a kernel fails as only a broken driver's does, nothing after it. The file is removed.
 *   "crash K" a launch of kernel K ends the process as long as the file is there; "hang K": it never returns; "wrong K": the kernel does not
 *             run, and the driver says that it did; "nobuild K": the program that has kernel K does not build.
 *             "kill K": as "crash K", by a signal that the driver does not send.
 *             All but "nobuild" happen on all devices, or on those whose name begins with DEVICE_FAULT_ON.
 *   "leak N"  after the next launch of a kernel, N MiB of memory are taken and never freed. The file is removed.
 *   "full N"  no buffer of more than N bytes can be had as long as the file is there.
 *   "peek"    the next launch of a kernel tries what a hostile driver would: to list or read each path in DEVICE_FAULT_PEEK (separated by
 *             colons), to make a file in it or beside it, to use TCP (the port in DEVICE_FAULT_PORT), to signal its parent and to read its
 *             memory. The file is removed; another one, its name with ".seen", has a line for each, with the
 *             outcome.
 *
 * A lost device answers "out of resources", as NVIDIA's driver does: the caller cannot tell that from memory that ran out. */
#define _GNU_SOURCE
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl_layer.h>
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_OBJECTS = 1024 };

static const struct _cl_icd_dispatch *target;
static struct _cl_icd_dispatch layer;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
/* Contexts and queues, each with how often the device was lost before it was made. */
static struct { void *object; int losses; } objects[MAX_OBJECTS];
static int object_count, losses, is_spoiled;

/* What the file says; empty if there is none, or if the environment has the variable that DEVICE_FAULT_UNLESS names. */
static void read_fault(char text[64]) {
    text[0] = 0;
    const char *path = getenv("DEVICE_FAULT"), *unless = getenv("DEVICE_FAULT_UNLESS");
    if (unless && getenv(unless)) return;
    FILE *file = path ? fopen(path, "r") : NULL;
    if (!file) return;
    if (!fgets(text, 64, file)) text[0] = 0;
    fclose(file);
    if (strcmp(text, "lost") == 0 || strcmp(text, "spoiled") == 0) {
        is_spoiled |= text[0] == 's';
        losses++;
        unlink(path);
    } else if (strcmp(text, "gone") == 0) {
        losses++;
    }
}

static int is_fault(const char *what) {
    char text[64];
    pthread_mutex_lock(&lock);
    read_fault(text);
    int is = strncmp(text, what, strlen(what)) == 0;
    if (is && strcmp(what, "fail") == 0) unlink(getenv("DEVICE_FAULT"));
    pthread_mutex_unlock(&lock);
    return is;
}

static void remember(void *object) {
    pthread_mutex_lock(&lock);
    int i = 0;
    while (i < object_count && objects[i].object != object) i++;
    if (i == MAX_OBJECTS) abort();
    if (i == object_count) object_count++;
    objects[i].object = object;
    objects[i].losses = losses;
    pthread_mutex_unlock(&lock);
}

static int is_lost(void *object) {
    char text[64];
    pthread_mutex_lock(&lock);
    read_fault(text);
    int is = 0;
    for (int i = 0; i < object_count; i++) is |= objects[i].object == object && objects[i].losses < losses;
    pthread_mutex_unlock(&lock);
    return is;
}

static cl_int CL_API_CALL get_device_ids(cl_platform_id platform, cl_device_type type, cl_uint space, cl_device_id *devices, cl_uint *count) {
    if (is_fault("gone")) return CL_DEVICE_NOT_FOUND;
    return target->clGetDeviceIDs(platform, type, space, devices, count);
}

static cl_context CL_API_CALL create_context(const cl_context_properties *properties, cl_uint count, const cl_device_id *devices,
                                             void(CL_CALLBACK *notify)(const char *, const void *, size_t, void *), void *data, cl_int *error) {
    int is_gone = is_fault("gone");
    if (is_gone || is_spoiled) {
        if (error) *error = is_gone ? CL_DEVICE_NOT_AVAILABLE : -9999;
        return NULL;
    }
    cl_context context = target->clCreateContext(properties, count, devices, notify, data, error);
    if (context) remember(context);
    return context;
}

static cl_command_queue CL_API_CALL create_queue(cl_context context, cl_device_id device, cl_command_queue_properties properties, cl_int *error) {
    cl_command_queue queue = target->clCreateCommandQueue(context, device, properties, error);
    if (queue) remember(queue);
    return queue;
}

static cl_mem CL_API_CALL create_buffer(cl_context context, cl_mem_flags flags, size_t bytes, void *host, cl_int *error) {
    char text[64];
    pthread_mutex_lock(&lock);
    read_fault(text);
    pthread_mutex_unlock(&lock);
    int is_full = strncmp(text, "full ", 5) == 0 && bytes > strtoull(text + 5, NULL, 10);
    if (is_full || is_lost(context)) {
        if (error) *error = is_full ? CL_MEM_OBJECT_ALLOCATION_FAILURE : CL_OUT_OF_RESOURCES;
        return NULL;
    }
    return target->clCreateBuffer(context, flags, bytes, host, error);
}

/* Whether launches on this queue may fail. */
static int is_on_faulty_device(cl_command_queue queue) {
    const char *on = getenv("DEVICE_FAULT_ON");
    cl_device_id device;
    char name[256] = "";
    if (!on) return 1;
    if (target->clGetCommandQueueInfo(queue, CL_QUEUE_DEVICE, sizeof device, &device, NULL)) return 0;
    return !target->clGetDeviceInfo(device, CL_DEVICE_NAME, sizeof name, name, NULL) && strncmp(name, on, strlen(on)) == 0;
}

/* Whether the file says that this happens to this kernel. */
static int is_kernel_fault(const char *what, cl_command_queue queue, cl_kernel kernel) {
    char name[64] = "", wanted[80];
    if (!is_on_faulty_device(queue)) return 0;
    if (target->clGetKernelInfo(kernel, CL_KERNEL_FUNCTION_NAME, sizeof name - 1, name, NULL)) return 0;
    snprintf(wanted, sizeof wanted, "%s %s", what, name);
    char text[64];
    pthread_mutex_lock(&lock);
    read_fault(text);
    pthread_mutex_unlock(&lock);
    return strcmp(text, wanted) == 0;
}

static cl_int CL_API_CALL build_program(cl_program program, cl_uint count, const cl_device_id *devices, const char *options,
                                        void(CL_CALLBACK *notify)(cl_program, void *), void *data) {
    char text[64], kernel[80];
    pthread_mutex_lock(&lock);
    read_fault(text);
    pthread_mutex_unlock(&lock);
    size_t bytes = 0;
    char *source = NULL;
    if (strncmp(text, "nobuild ", 8) == 0 && !target->clGetProgramInfo(program, CL_PROGRAM_SOURCE, 0, NULL, &bytes) && (source = malloc(bytes))) {
        snprintf(kernel, sizeof kernel, "void %s(", text + 8);
        int is = !target->clGetProgramInfo(program, CL_PROGRAM_SOURCE, bytes, source, NULL) && strstr(source, kernel);
        free(source);
        if (is) return CL_BUILD_PROGRAM_FAILURE;
    }
    /* The kernels of a workaround are no other test's: without optimisation they are compiled in a third of the time. */
    const char *workaround = getenv("POCL_WORK_GROUP_METHOD");
    char *with = NULL;
    if (workaround && asprintf(&with, "%s -cl-opt-disable", options ? options : "") >= 0) options = with;
    cl_int result = target->clBuildProgram(program, count, devices, options, notify, data);
    free(with);
    return result;
}

static void *take_memory(void *bytes) {
    /* Static, or the compiler leaves both calls out. */
    static void *volatile memory;
    memory = malloc((size_t)bytes);
    if (memory) memset(memory, 1, (size_t)bytes);
    return NULL;
}

/* Takes memory if the file says so. In a thread of its own: where the system has to find the pages, that takes seconds, in which a launch that
 * waited for it would be stuck. */
static void leak(void) {
    char text[64];
    pthread_mutex_lock(&lock);
    read_fault(text);
    int is = strncmp(text, "leak ", 5) == 0;
    if (is) unlink(getenv("DEVICE_FAULT"));
    pthread_mutex_unlock(&lock);
    pthread_t thread;
    if (is && pthread_create(&thread, NULL, take_memory, (void *)(strtoull(text + 5, NULL, 10) << 20)) == 0) pthread_detach(thread);
}

static void write_outcome(FILE *out, const char *what, const char *where, int result) {
    fprintf(out, "%s %s: %s\n", what, where, result < 0 ? strerror(errno) : "done");
}

/* Tries to list or read a path, and to make a file in it or beside it. */
static void try_path(FILE *out, const char *path) {
    struct stat status;
    char made[4096];
    int is_folder = stat(path, &status) == 0 && S_ISDIR(status.st_mode);
    int file = open(path, O_RDONLY);
    write_outcome(out, "read", path, file);
    if (file >= 0) close(file);
    snprintf(made, sizeof made, is_folder ? "%s/made" : "%s.made", path);
    file = open(made, O_WRONLY | O_CREAT, 0600);
    write_outcome(out, "make", path, file);
    if (file >= 0) {
        close(file);
        unlink(made);
    }
}

/* Tries what a hostile driver would, if the file says so. */
static void peek(void) {
    char text[64], seen[4096], unfinished[4096], memory[64];
    const char *path = getenv("DEVICE_FAULT"), *paths = getenv("DEVICE_FAULT_PEEK"), *port = getenv("DEVICE_FAULT_PORT");
    pthread_mutex_lock(&lock);
    read_fault(text);
    int is = strcmp(text, "peek") == 0 && paths && port;
    if (is) unlink(path);
    pthread_mutex_unlock(&lock);
    if (!is) return;
    snprintf(seen, sizeof seen, "%s.seen", path);
    snprintf(unfinished, sizeof unfinished, "%s.unfinished", path);
    FILE *out = fopen(unfinished, "w");
    if (!out) return;
    char *list = strdup(paths), *rest = list, *one;
    while ((one = strsep(&rest, ":"))) try_path(out, one);
    free(list);
    try_path(out, getenv("TMPDIR"));
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_port = htons(atoi(port)), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    int client = socket(AF_INET, SOCK_STREAM, 0), server = socket(AF_INET, SOCK_STREAM, 0);
    write_outcome(out, "connect", "TCP", connect(client, (struct sockaddr *)&address, sizeof address));
    address.sin_port = 0;
    write_outcome(out, "listen", "TCP", bind(server, (struct sockaddr *)&address, sizeof address));
    write_outcome(out, "signal", "parent", kill(getppid(), 0));
    snprintf(memory, sizeof memory, "/proc/%d/mem", getppid());
    write_outcome(out, "memory", "parent", open(memory, O_RDONLY));
    fclose(out);
    rename(unfinished, seen);
}

static cl_int CL_API_CALL enqueue_kernel(cl_command_queue queue, cl_kernel kernel, cl_uint dims, const size_t *offset, const size_t *global,
                                         const size_t *local, cl_uint waits, const cl_event *wait_list, cl_event *event) {
    if (is_lost(queue)) return CL_OUT_OF_RESOURCES;
    if (is_fault("fail")) return CL_INVALID_OPERATION;
    leak();
    peek();
    if (is_kernel_fault("crash", queue, kernel)) abort();
    if (is_kernel_fault("kill", queue, kernel)) raise(SIGKILL);
    while (is_kernel_fault("hang", queue, kernel)) sleep(1);
    if (is_kernel_fault("wrong", queue, kernel)) return target->clEnqueueMarkerWithWaitList(queue, waits, wait_list, event);
    return target->clEnqueueNDRangeKernel(queue, kernel, dims, offset, global, local, waits, wait_list, event);
}

static cl_int CL_API_CALL read_buffer(cl_command_queue queue, cl_mem buffer, cl_bool blocking, size_t offset, size_t bytes, void *to,
                                      cl_uint waits, const cl_event *wait_list, cl_event *event) {
    if (is_lost(queue)) return CL_OUT_OF_RESOURCES;
    return target->clEnqueueReadBuffer(queue, buffer, blocking, offset, bytes, to, waits, wait_list, event);
}

static cl_int CL_API_CALL write_buffer(cl_command_queue queue, cl_mem buffer, cl_bool blocking, size_t offset, size_t bytes,
                                       const void *from, cl_uint waits, const cl_event *wait_list, cl_event *event) {
    if (is_lost(queue)) return CL_OUT_OF_RESOURCES;
    return target->clEnqueueWriteBuffer(queue, buffer, blocking, offset, bytes, from, waits, wait_list, event);
}

static cl_int CL_API_CALL fill_buffer(cl_command_queue queue, cl_mem buffer, const void *pattern, size_t pattern_bytes, size_t offset,
                                      size_t bytes, cl_uint waits, const cl_event *wait_list, cl_event *event) {
    if (is_lost(queue)) return CL_OUT_OF_RESOURCES;
    return target->clEnqueueFillBuffer(queue, buffer, pattern, pattern_bytes, offset, bytes, waits, wait_list, event);
}

static void *CL_API_CALL map_buffer(cl_command_queue queue, cl_mem buffer, cl_bool blocking, cl_map_flags flags, size_t offset,
                                    size_t bytes, cl_uint waits, const cl_event *wait_list, cl_event *event, cl_int *error) {
    if (is_lost(queue)) {
        if (error) *error = CL_OUT_OF_RESOURCES;
        return NULL;
    }
    return target->clEnqueueMapBuffer(queue, buffer, blocking, flags, offset, bytes, waits, wait_list, event, error);
}

static cl_int CL_API_CALL finish(cl_command_queue queue) {
    return is_lost(queue) ? CL_OUT_OF_RESOURCES : target->clFinish(queue);
}

CL_API_ENTRY cl_int CL_API_CALL clGetLayerInfo(cl_layer_info name, size_t space, void *value, size_t *bytes) {
    static const cl_layer_api_version version = CL_LAYER_API_VERSION_100;
    if (name != CL_LAYER_API_VERSION || (value && space < sizeof version)) return CL_INVALID_VALUE;
    if (value) memcpy(value, &version, sizeof version);
    if (bytes) *bytes = sizeof version;
    return CL_SUCCESS;
}

CL_API_ENTRY cl_int CL_API_CALL clInitLayer(cl_uint entries, const struct _cl_icd_dispatch *dispatch, cl_uint *layer_entries,
                                            const struct _cl_icd_dispatch **layer_dispatch) {
    if (entries * sizeof(void *) < offsetof(struct _cl_icd_dispatch, clEnqueueFillBuffer) + sizeof(void *)) return CL_INVALID_VALUE;
    size_t bytes = entries * sizeof(void *);
    target = dispatch;
    memcpy(&layer, dispatch, bytes < sizeof layer ? bytes : sizeof layer);
    layer.clGetDeviceIDs = get_device_ids;
    layer.clCreateContext = create_context;
    layer.clCreateCommandQueue = create_queue;
    layer.clCreateBuffer = create_buffer;
    layer.clBuildProgram = build_program;
    layer.clEnqueueNDRangeKernel = enqueue_kernel;
    layer.clEnqueueReadBuffer = read_buffer;
    layer.clEnqueueWriteBuffer = write_buffer;
    layer.clEnqueueFillBuffer = fill_buffer;
    layer.clEnqueueMapBuffer = map_buffer;
    layer.clFinish = finish;
    *layer_entries = sizeof layer / sizeof(void *);
    *layer_dispatch = &layer;
    return CL_SUCCESS;
}
