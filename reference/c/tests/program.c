/* Calls every function of trgs.h and prints what it gets, numbers as the bits of doubles. */

#include "trgs.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { COUNT = 3, VIEWS = 2, ROWS = 5, COLUMNS = 6, X = 4, Y = 3, Z = 5 };

static const double MEAN[COUNT][3] = {{0.1, -0.2, 0.3}, {-0.4, 0.25, 0.0}, {0.0, 0.0, -0.35}};
static const double SCALE[COUNT][3] = {{0.2, 0.3, 0.25}, {0.15, 0.1, 0.4}, {0.3, 0.3, 0.3}};
static const double QUATERNION[COUNT][4] = {{1, 0, 0, 0}, {0.5, -0.5, 0.25, 1.0}, {2, 0.1, 0, 0}};
static const double DENSITY[COUNT] = {1.0, 0.5, 2.0};
static const double NU[COUNT] = {3.0, 8.0, 40.0};
static const double ANGLES[VIEWS] = {0.0, 0.7};

static void fail(const char *what, trgs_error *error) {
    fprintf(stderr, "%s: %s\n", what, trgs_error_message(error));
    trgs_error_free(error);
    exit(1);
}

static void print_number(double value) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    printf(" 0x%016" PRIx64, bits);
}

static void print(const char *name, const double *values, size_t count) {
    printf("%s", name);
    for (size_t i = 0; i < count; i++) print_number(values[i]);
    printf("\n");
}

static void print_f32(const char *name, const float *values, size_t count) {
    printf("%s", name);
    for (size_t i = 0; i < count; i++) print_number((double)values[i]);
    printf("\n");
}

static void print_gradient(const char *name, const trgs_gradient *gradient) {
    printf("%s\n", name);
    print("mean", gradient->mean, COUNT * 3);
    print("scale", gradient->scale, COUNT * 3);
    print("quaternion", gradient->quaternion, COUNT * 4);
    print("density", gradient->density, COUNT);
    print("nu", gradient->nu, COUNT);
}

/* What must fail: prints the message. */
static void refused(int succeeded, trgs_error **error) {
    if (succeeded || *error == NULL) {
        fprintf(stderr, "a call that must fail did not\n");
        exit(1);
    }
    printf("error %s\n", trgs_error_message(*error));
    trgs_error_free(*error);
    *error = NULL;
}

int main(int count, char **arguments) {
    trgs_error *error = NULL;
    trgs_model *model = trgs_model_new(COUNT, &MEAN[0][0], &SCALE[0][0], &QUATERNION[0][0], DENSITY, NU, &error);
    if (!model) fail("model", error);
    trgs_model *gaussians = trgs_model_new(COUNT, &MEAN[0][0], &SCALE[0][0], &QUATERNION[0][0], DENSITY, NULL, &error);
    if (!gaussians) fail("gaussians", error);
    const trgs_detector detector = {ROWS, COLUMNS, 0.7, 0.6, 0.05, -0.1};
    const trgs_grid grid = {{X, Y, Z}, {-1, -1, -1}, {1, 1, 1}};
    trgs_scanner *cone = trgs_scanner_cone(5.0, 7.0, &detector, &grid, &error);
    if (!cone) fail("cone", error);
    trgs_scanner *parallel = trgs_scanner_parallel(&detector, &grid, &error);
    if (!parallel) fail("parallel", error);
    printf("version %s\ncount %zu %zu\n", trgs_version(), trgs_model_count(model), trgs_model_count(NULL));

    double images[VIEWS * ROWS * COLUMNS], volume[X * Y * Z];
    float images_f32[VIEWS * ROWS * COLUMNS], volume_f32[X * Y * Z];
    const size_t pixels = VIEWS * ROWS * COLUMNS, voxels = X * Y * Z;
    if (!trgs_project(model, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, images, pixels, &error)) fail("project", error);
    print("exact", images, pixels);
    if (!trgs_project(model, cone, VIEWS, ANGLES, TRGS_AFFINE, 1e-3, images, pixels, &error)) fail("project", error);
    print("affine", images, pixels);
    if (!trgs_project(gaussians, parallel, VIEWS, ANGLES, TRGS_EXACT, 0.0, images, pixels, &error)) fail("project", error);
    print("parallel", images, pixels);
    if (!trgs_project_f32(model, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, images_f32, pixels, &error)) fail("f32", error);
    print_f32("exact_f32", images_f32, pixels);
    if (!trgs_voxelize(model, &grid, 0.0, volume, voxels, &error)) fail("voxelize", error);
    print("volume", volume, voxels);
    if (!trgs_voxelize_f32(model, &grid, 0.0, volume_f32, voxels, &error)) fail("voxelize_f32", error);
    print_f32("volume_f32", volume_f32, voxels);

    /* Cotangents: 1, 2, 3, ... */
    for (size_t i = 0; i < pixels; i++) images[i] = (double)(images_f32[i] = (float)(i + 1));
    for (size_t i = 0; i < voxels; i++) volume[i] = (double)(volume_f32[i] = (float)(i + 1));
    double mean[COUNT * 3], scale[COUNT * 3], quaternion[COUNT * 4], density[COUNT], nu[COUNT];
    trgs_gradient gradient = {mean, scale, quaternion, density, nu};
    if (!trgs_project_vjp(model, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, images, pixels, &gradient, &error)) fail("vjp", error);
    print_gradient("project_vjp", &gradient);
    if (!trgs_project_vjp_f32(model, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, images_f32, pixels, &gradient, &error)) fail("vjp", error);
    print_gradient("project_vjp_f32", &gradient);
    if (!trgs_voxelize_vjp(model, &grid, 0.0, volume, voxels, &gradient, &error)) fail("vjp", error);
    print_gradient("voxelize_vjp", &gradient);
    if (!trgs_voxelize_vjp_f32(model, &grid, 0.0, volume_f32, voxels, &gradient, &error)) fail("vjp", error);
    print_gradient("voxelize_vjp_f32", &gradient);
    /* Groups that are left out, and no place for an error. */
    trgs_gradient part = {NULL, NULL, NULL, density, NULL};
    density[0] = 0.0;
    if (!trgs_voxelize_vjp(model, &grid, 0.0, volume, voxels, &part, NULL)) fail("part", NULL);
    print("part", density, COUNT);

    /* A round trip through files. */
    trgs_model *read = trgs_model_read(count > 1 ? arguments[1] : NULL, &error);
    if (!read) fail("read", error);
    trgs_scanner *scanner = trgs_scanner_read(count > 2 ? arguments[2] : NULL, &error);
    if (!scanner) fail("scanner", error);
    printf("read %zu\n", trgs_model_count(read));

    const double negative[COUNT] = {1.0, -1.0, 1.0}, odd[VIEWS] = {0.0, NAN};
    refused(trgs_model_new(COUNT, &MEAN[0][0], &SCALE[0][0], &QUATERNION[0][0], DENSITY, negative, &error) != NULL, &error);
    refused(trgs_model_new(COUNT, NULL, &SCALE[0][0], &QUATERNION[0][0], DENSITY, NU, &error) != NULL, &error);
    refused(trgs_model_read("missing.npz", &error) != NULL, &error);
    refused(trgs_scanner_read(NULL, &error) != NULL, &error);
    refused(trgs_scanner_cone(0.5, 7.0, &detector, &grid, &error) != NULL, &error);
    refused(trgs_scanner_cone(5.0, 7.0, NULL, &grid, &error) != NULL, &error);
    refused(trgs_project(model, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, images, pixels - 1, &error), &error);
    refused(trgs_project(model, cone, VIEWS, odd, TRGS_EXACT, 0.0, images, pixels, &error), &error);
    refused(trgs_project(model, cone, VIEWS, ANGLES, 2, 0.0, images, pixels, &error), &error);
    refused(trgs_project(model, cone, VIEWS, ANGLES, TRGS_EXACT, 1.0, images, pixels, &error), &error);
    refused(trgs_project(NULL, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, images, pixels, &error), &error);
    refused(trgs_project(model, cone, VIEWS, ANGLES, TRGS_EXACT, 0.0, NULL, pixels, &error), &error);
    refused(trgs_voxelize_vjp(model, &grid, 0.0, volume, voxels, NULL, &error), &error);

    trgs_scanner_free(scanner);
    trgs_scanner_free(parallel);
    trgs_scanner_free(cone);
    trgs_model_free(read);
    trgs_model_free(gaussians);
    trgs_model_free(model);
    trgs_model_free(NULL);
    trgs_scanner_free(NULL);
    trgs_error_free(NULL);
    return 0;
}
