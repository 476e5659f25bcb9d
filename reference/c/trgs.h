/*
 * trgs: projections and volumes of Student's t-kernels, and their gradients.
 *
 * Lengths are in scene units, angles in radians, densities in attenuation per scene unit. Arrays are contiguous, with the
 * last index fastest. World coordinates are right-handed and z is the axis of rotation. At angle a the source is at
 * dso (cos a, sin a, 0). Row 0 of an image is at the top (+z), and columns run along (-sin a, cos a, 0).
 *
 * Functions that can fail take `error`, a place for an error or NULL. On failure they return NULL or false, write nothing
 * else, and put an error there, which the caller gives to trgs_error_free. Any thread may call any function; a model and a
 * scanner never change. Results have the same bits on every processor and with any number of threads.
 *
 * Written by `TRGS_WRITE=1 cargo test --profile checked --package trgs-c`.
 */

#ifndef TRGS_H
#define TRGS_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

// Value of `projection`: the line integral along the ray of each pixel.
#define TRGS_EXACT 0

// Value of `projection`: the paper's approximation, in which all rays of a primitive are parallel to the one through its
// centre.
#define TRGS_AFFINE 1

// What was wrong, what was found and expected, and the remedy.
typedef struct trgs_error trgs_error;

// Primitives: kernels whose sum is the density.
typedef struct trgs_model trgs_model;

// Beam, detector and grid of a scan.
typedef struct trgs_scanner trgs_scanner;

// A flat detector.
typedef struct trgs_detector {
  // Number of rows.
  size_t rows;
  // Number of columns.
  size_t columns;
  // Distance between rows.
  double pitch_v;
  // Distance between columns.
  double pitch_u;
  // Shift of the detector towards higher rows, which are lower in space.
  double offset_v;
  // Shift of the detector towards higher columns.
  double offset_u;
} trgs_detector;

// An axis-aligned box of voxels.
typedef struct trgs_grid {
  // Voxels along x, y and z.
  size_t shape[3];
  // The corner with the smallest coordinates.
  double low[3];
  // The corner with the largest coordinates.
  double high[3];
} trgs_grid;

// Arrays of one row per primitive, in which a gradient is written. A group whose pointer is NULL is left out.
typedef struct trgs_gradient {
  // `[count][3]`, to the centres.
  double *mean;
  // `[count][3]`, to the standard deviations along the principal axes.
  double *scale;
  // `[count][4]`, to the quaternions as they were given, of any length.
  double *quaternion;
  // `[count]`, to the densities.
  double *density;
  // `[count]`, to the degrees of freedom; 0 of Gaussians.
  double *nu;
} trgs_gradient;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The version of the library. The caller does not free it.
const char *trgs_version(void);

// The message of an error, valid until the error is freed; NULL of NULL.
//
// # Safety
// `error` is NULL or an error that was not freed.
const char *trgs_error_message(const struct trgs_error *error);

// Frees an error; NULL is allowed.
//
// # Safety
// `error` is NULL or an error that was not freed.
void trgs_error_free(struct trgs_error *error);

// A model of `count` primitives, from copies of the arrays.
//
// `mean`, `scale` (positive) and `quaternion` (w, x, y, z; any length but 0) have 3, 3 and 4 numbers per primitive,
// `density` and `nu` (positive) one. With `nu` NULL, or infinite throughout, the kernels are Gaussian. Fails for the first
// value that cannot be used.
//
// # Safety
// The arrays have `count` rows. `error` is NULL or a place for an error.
struct trgs_model *trgs_model_new(size_t count,
                                  const double *mean,
                                  const double *scale,
                                  const double *quaternion,
                                  const double *density,
                                  const double *nu,
                                  struct trgs_error **error);

// Reads a model: `.npz`, `.ply`, or a model of R²-Gaussian. `path` is UTF-8. Fails for a damaged file.
//
// # Safety
// `path` is NULL or ends with a zero. `error` is NULL or a place for an error.
struct trgs_model *trgs_model_read(const char *path,
                                   struct trgs_error **error);

// The number of primitives; 0 of NULL.
//
// # Safety
// `model` is NULL or a model that was not freed.
size_t trgs_model_count(const struct trgs_model *model);

// Frees a model; NULL is allowed.
//
// # Safety
// `model` is NULL or a model that was not freed.
void trgs_model_free(struct trgs_model *model);

// A scanner with a point source, `dso` from the axis of rotation and `dsd` from the detector.
//
// Fails for sizes that are not positive, a source in the volume, or a detector that does not see the volume.
//
// # Safety
// `detector` and `grid` are NULL or valid. `error` is NULL or a place for an error.
struct trgs_scanner *trgs_scanner_cone(double dso,
                                       double dsd,
                                       const struct trgs_detector *detector,
                                       const struct trgs_grid *grid,
                                       struct trgs_error **error);

// A scanner whose rays are perpendicular to the detector. Fails as `trgs_scanner_cone` does.
//
// # Safety
// As of `trgs_scanner_cone`.
struct trgs_scanner *trgs_scanner_parallel(const struct trgs_detector *detector,
                                           const struct trgs_grid *grid,
                                           struct trgs_error **error);

// Reads the scanner of a dataset: its folder, its `meta_data.json`, or a pickle of NAF. `path` is UTF-8.
//
// # Safety
// `path` is NULL or ends with a zero. `error` is NULL or a place for an error.
struct trgs_scanner *trgs_scanner_read(const char *path,
                                       struct trgs_error **error);

// Frees a scanner; NULL is allowed.
//
// # Safety
// `scanner` is NULL or a scanner that was not freed.
void trgs_scanner_free(struct trgs_scanner *scanner);

// Projections `images[views][rows][columns]` in double precision, scene units of length times density.
//
// `projection` is `TRGS_EXACT` or `TRGS_AFFINE`. A primitive ends where its projection has fallen to the fraction `cutoff`
// of its peak; 0: nowhere, which is exact and slow; training uses 1e-3. `length` is the number of elements of `images`.
//
// # Safety
// `model` and `scanner` are NULL or were not freed, arrays have the stated lengths, `error` is NULL or a place for an
// error.
bool trgs_project(const struct trgs_model *model,
                  const struct trgs_scanner *scanner,
                  size_t views,
                  const double *angles,
                  uint32_t projection,
                  double cutoff,
                  double *images,
                  size_t length,
                  struct trgs_error **error);

// `trgs_project` in single precision.
//
// # Safety
// As of `trgs_project`.
bool trgs_project_f32(const struct trgs_model *model,
                      const struct trgs_scanner *scanner,
                      size_t views,
                      const double *angles,
                      uint32_t projection,
                      double cutoff,
                      float *images,
                      size_t length,
                      struct trgs_error **error);

// The gradient of the sum of cotangent times projection to the parameters of the model.
//
// `cotangent` has the shape of `images` of `trgs_project`, and `length` elements.
//
// # Safety
// As of `trgs_project`; the arrays of `gradient` have as many rows as the model.
bool trgs_project_vjp(const struct trgs_model *model,
                      const struct trgs_scanner *scanner,
                      size_t views,
                      const double *angles,
                      uint32_t projection,
                      double cutoff,
                      const double *cotangent,
                      size_t length,
                      const struct trgs_gradient *gradient,
                      struct trgs_error **error);

// `trgs_project_vjp` in single precision; the gradient is in double precision.
//
// # Safety
// As of `trgs_project_vjp`.
bool trgs_project_vjp_f32(const struct trgs_model *model,
                          const struct trgs_scanner *scanner,
                          size_t views,
                          const double *angles,
                          uint32_t projection,
                          double cutoff,
                          const float *cotangent,
                          size_t length,
                          const struct trgs_gradient *gradient,
                          struct trgs_error **error);

// The density `volume[x][y][z]` at the voxel centres of a grid in double precision, attenuation per scene unit.
//
// `cutoff` is that of `trgs_project`, and `length` the number of elements of `volume`.
//
// # Safety
// `model` is NULL or was not freed, `grid` is NULL or valid, arrays have the stated lengths, `error` is NULL or a place for
// an error.
bool trgs_voxelize(const struct trgs_model *model,
                   const struct trgs_grid *grid,
                   double cutoff,
                   double *volume,
                   size_t length,
                   struct trgs_error **error);

// `trgs_voxelize` in single precision.
//
// # Safety
// As of `trgs_voxelize`.
bool trgs_voxelize_f32(const struct trgs_model *model,
                       const struct trgs_grid *grid,
                       double cutoff,
                       float *volume,
                       size_t length,
                       struct trgs_error **error);

// The gradient of the sum of cotangent times volume to the parameters of the model.
//
// `cotangent` has the shape of `volume` of `trgs_voxelize`, and `length` elements.
//
// # Safety
// As of `trgs_voxelize`; the arrays of `gradient` have as many rows as the model.
bool trgs_voxelize_vjp(const struct trgs_model *model,
                       const struct trgs_grid *grid,
                       double cutoff,
                       const double *cotangent,
                       size_t length,
                       const struct trgs_gradient *gradient,
                       struct trgs_error **error);

// `trgs_voxelize_vjp` in single precision; the gradient is in double precision.
//
// # Safety
// As of `trgs_voxelize_vjp`.
bool trgs_voxelize_vjp_f32(const struct trgs_model *model,
                           const struct trgs_grid *grid,
                           double cutoff,
                           const float *cotangent,
                           size_t length,
                           const struct trgs_gradient *gradient,
                           struct trgs_error **error);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* TRGS_H */
