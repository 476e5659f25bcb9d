//! The surface of a volume at a level, as a closed mesh for printers and viewers: STL, PLY, GLB.
//!
//! Surface nets place one vertex in each cell of eight voxels that the surface crosses. Where the object leaves the volume,
//! the mesh is closed at the faces of the outer voxels. Vertices are in millimetres, or in the unit of the file if that is
//! not known, in the patient's coordinates of [`volume_file`](super::volume_file).

use super::volume_file::{VolumeFile, range};
use crate::Unit;
use crate::output::write_atomically;
use fast_surface_nets::ndshape::{RuntimeShape, Shape};
use fast_surface_nets::{SurfaceNetsBuffer, surface_nets};
use glam::{DMat3, DVec3, Vec3};
use ndarray::Array3;
use serde::Serialize;
use serde_json::json;
use serde_ply::SerializeOptions;
use std::io::{self, Write};
use std::path::Path;
use trgs_core::error::{Error, Result};

/// Intervals of the histogram that a level is chosen by.
const BINS: usize = 512;
/// Quarter turn about x that makes z, the head's direction, the y of glTF, which points upwards.
const UPRIGHT: [f64; 4] = [-std::f64::consts::FRAC_1_SQRT_2, 0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2];
/// Type of a chunk of GLB.
const JSON: &[u8; 4] = b"JSON";
const BINARY: &[u8; 4] = b"BIN\0";

/// A closed surface; triangles are counter-clockwise seen from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices.
    pub positions: Vec<Vec3>,
    /// Unit vectors outwards, one for each vertex.
    pub normals: Vec<Vec3>,
    /// Three vertices each.
    pub triangles: Vec<[u32; 3]>,
    /// Whether lengths are in millimetres.
    in_millimetres: bool,
}

#[derive(Serialize)]
struct Ply {
    vertex: Vec<Vertex>,
    face: Vec<Face>,
}

#[derive(Serialize)]
struct Vertex {
    x: f32,
    y: f32,
    z: f32,
    nx: f32,
    ny: f32,
    nz: f32,
}

#[derive(Serialize)]
struct Face {
    vertex_indices: Vec<u32>,
}

impl Mesh {
    /// The surface around the values above `level`, in the unit of the values.
    ///
    /// # Errors
    /// When no value is above the level, and for more voxels than a mesh can count.
    pub fn of(volume: &VolumeFile, level: f64) -> Result<Self> {
        let values = &volume.values;
        let above = values.iter().filter(|&&value| f64::from(value) > level).count();
        if !level.is_finite() || above == 0 {
            let highest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            let expected = format!("less than {highest}, the highest value of the volume");
            return Err(Error::invalid("level of the surface", level, expected, "give a lower level"));
        }
        // A layer of voxels around the volume mirrors what is beside it, outside the surface.
        let padded = <[usize; 3]>::from(values.dim()).map(|count| count + 2);
        if padded.iter().product::<usize>() > u32::MAX as usize {
            let expected = format!("at most {} voxels", u32::MAX);
            return Err(Error::invalid(
                "volume of a surface",
                format!("{:?} voxels", values.dim()),
                expected,
                "bin it first",
            ));
        }
        let distance = |(x, y, z): (usize, usize, usize)| {
            let place = [x, y, z];
            let nearest = [0, 1, 2].map(|axis| place[axis].clamp(1, padded[axis] - 2));
            let value = f64::from(values[nearest.map(|index| index - 1)]);
            let distance = (level - if value.is_finite() { value } else { f64::MIN }) as f32;
            if nearest == place { distance } else { distance.abs() }
        };
        let distances = Array3::from_shape_fn(padded, distance);
        // The last axis is the fastest in memory: the crate's x.
        let shape = RuntimeShape::<u32, 3>::new([padded[2], padded[1], padded[0]].map(|count| count as u32));
        let mut found = SurfaceNetsBuffer::default();
        let distances = distances.as_slice().expect("made in C order");
        surface_nets(distances, &shape, [0; 3], shape.as_array().map(|count| count - 1), &mut found);
        let factor = volume.unit.map_or(1.0, Unit::millimetres);
        let spacing = volume.spacing.unwrap_or(DVec3::ONE);
        let origin = volume.origin.unwrap_or(DVec3::ZERO);
        let place = |&[z, y, x]: &[f32; 3]| {
            let index = DVec3::new(x.into(), y.into(), z.into()) - 1.0;
            ((origin + volume.directions * (spacing * index)) * factor).as_vec3()
        };
        let outwards = |&[z, y, x]: &[f32; 3]| {
            let gradient = DVec3::new(x.into(), y.into(), z.into()) / spacing;
            (volume.directions * gradient).normalize_or(DVec3::Z).as_vec3()
        };
        // Exchanging the axes mirrors the mesh, as directions may do.
        let is_mirrored = volume.directions.determinant() > 0.0;
        let triangle = |corners: &[u32]| match is_mirrored {
            true => [corners[0], corners[2], corners[1]],
            false => [corners[0], corners[1], corners[2]],
        };
        Ok(Self {
            positions: found.positions.iter().map(place).collect(),
            normals: found.normals.iter().map(outwards).collect(),
            triangles: found.indices.chunks_exact(3).map(triangle).collect(),
            in_millimetres: volume.unit.is_some(),
        })
    }

    /// The corners of all triangles.
    fn corners(&self) -> impl Iterator<Item = [Vec3; 3]> {
        self.triangles.iter().map(|corners| corners.map(|corner| self.positions[corner as usize]))
    }

    /// The volume inside.
    pub fn volume(&self) -> f64 {
        let signed = |corners: [Vec3; 3]| DMat3::from_cols_array_2d(&corners.map(|at| at.as_dvec3().to_array()));
        self.corners().map(|corners| signed(corners).determinant() / 6.0).sum()
    }

    /// Whether a name is that of a surface; `.ply` may also be a model's.
    pub fn is_written_as(extension: &str) -> bool {
        ["stl", "glb", "ply"].contains(&extension)
    }

    /// Writes the surface as `.stl`, `.glb`, or else `.ply`.
    ///
    /// # Errors
    /// [`Error::Write`] with the error of the operating system.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let path = path.as_ref();
        write_atomically(path, |file| match path.extension().and_then(|extension| extension.to_str()) {
            Some("stl") => self.stl(file),
            Some("glb") => self.glb(file),
            _ => self.ply(file),
        })
    }

    /// Binary STL: a header, and for each triangle its normal, its corners and two unused bytes.
    fn stl(&self, file: &mut impl Write) -> io::Result<()> {
        let mut header = [0; 80];
        // No header of a binary file may begin with "solid".
        let words = if self.in_millimetres { "trgs, millimetres" } else { "trgs" };
        header[..words.len()].copy_from_slice(words.as_bytes());
        file.write_all(&header)?;
        file.write_all(&(self.triangles.len() as u32).to_le_bytes())?;
        for [a, b, c] in self.corners() {
            let normal = (b - a).cross(c - a).normalize_or_zero();
            for vector in [normal, a, b, c] {
                file.write_all(&bytes(vector.to_array()))?;
            }
            file.write_all(&[0; 2])?;
        }
        Ok(())
    }

    fn ply(&self, file: &mut impl Write) -> io::Result<()> {
        let vertex = |(at, normal): (&Vec3, &Vec3)| {
            let ([x, y, z], [nx, ny, nz]) = (at.to_array(), normal.to_array());
            Vertex { x, y, z, nx, ny, nz }
        };
        let content = Ply {
            vertex: self.positions.iter().zip(&self.normals).map(vertex).collect(),
            face: self.triangles.iter().map(|corners| Face { vertex_indices: corners.to_vec() }).collect(),
        };
        let unit = if self.in_millimetres { "millimetres" } else { "the unit of the volume" };
        let options = SerializeOptions::binary_le().with_comments(vec![format!("surface of trgs; lengths in {unit}")]);
        serde_ply::to_writer(&content, options, file).map_err(io::Error::other)
    }

    /// Binary glTF: the metre is its unit, and y points upwards, which its node makes of the mesh.
    fn glb(&self, file: &mut impl Write) -> io::Result<()> {
        let ends = |start: f32, of: fn(Vec3, Vec3) -> Vec3| self.positions.iter().copied().fold(Vec3::splat(start), of);
        let (low, high) = (ends(f32::INFINITY, Vec3::min), ends(f32::NEG_INFINITY, Vec3::max));
        let [of_vectors, of_triangles] = [12 * self.positions.len(), 12 * self.triangles.len()];
        let binary = 2 * of_vectors + of_triangles;
        let scale = if self.in_millimetres { 1e-3 } else { 1.0 };
        let view = |start: usize, length: usize, target: u32| json!({ "buffer": 0, "byteOffset": start, "byteLength": length, "target": target });
        let accessor = |view: usize, kind: u32, count: usize, shape: &str| json!({ "bufferView": view, "componentType": kind, "count": count, "type": shape });
        let mut positions = accessor(0, 5126, self.positions.len(), "VEC3");
        positions["min"] = json!(low.to_array());
        positions["max"] = json!(high.to_array());
        let content = json!({
            "asset": { "version": "2.0", "generator": "trgs" },
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": [{ "mesh": 0, "rotation": UPRIGHT, "scale": [scale, scale, scale] }],
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 2, "material": 0 }] }],
            "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.9, 0.87, 0.8, 1.0], "metallicFactor": 0.0 } }],
            "buffers": [{ "byteLength": binary }],
            "bufferViews": [view(0, of_vectors, 34962), view(of_vectors, of_vectors, 34962), view(2 * of_vectors, of_triangles, 34963)],
            "accessors": [
                positions,
                accessor(1, 5126, self.normals.len(), "VEC3"),
                accessor(2, 5125, 3 * self.triangles.len(), "SCALAR"),
            ],
        });
        // Chunks have whole words; JSON is filled up with spaces.
        let mut content = content.to_string().into_bytes();
        content.resize(content.len().next_multiple_of(4), b' ');
        file.write_all(b"glTF")?;
        for number in [2, 12 + 8 + content.len() + 8 + binary, content.len()] {
            file.write_all(&(number as u32).to_le_bytes())?;
        }
        file.write_all(JSON)?;
        file.write_all(&content)?;
        file.write_all(&(binary as u32).to_le_bytes())?;
        file.write_all(BINARY)?;
        for vector in self.positions.iter().chain(&self.normals) {
            file.write_all(&bytes(vector.to_array()))?;
        }
        self.triangles
            .iter()
            .try_for_each(|corners| corners.iter().try_for_each(|corner| file.write_all(&corner.to_le_bytes())))
    }
}

/// The level that parts the values best into two classes: Otsu's method.
pub fn otsu(volume: &VolumeFile) -> f64 {
    let (low, high) = range(&volume.values);
    if low >= high {
        return low;
    }
    let mut counts = [0_u64; BINS];
    let finite = volume.values.iter().copied().filter(|value| value.is_finite()).map(f64::from);
    finite.for_each(|value| counts[(((value - low) / (high - low) * BINS as f64) as usize).min(BINS - 1)] += 1);
    let all = counts.iter().sum::<u64>() as f64;
    let total: f64 = counts.iter().enumerate().map(|(bin, &count)| bin as f64 * count as f64).sum();
    let mut best = (0.0, 0.0, 0.0);
    let (mut below, mut moment_below) = (0.0, 0.0);
    for (bin, &count) in counts[..BINS - 1].iter().enumerate() {
        (below, moment_below) = (below + count as f64, moment_below + bin as f64 * count as f64);
        let means = [moment_below / below, (total - moment_below) / (all - below)];
        let between = below * (all - below) * (means[1] - means[0]) * (means[1] - means[0]);
        // Levels in a gap between the classes are equally good: the middle of it is taken.
        if between > best.0 {
            best = (between, bin as f64, bin as f64);
        } else if between == best.0 {
            best.2 = bin as f64;
        }
    }
    low + (high - low) * ((best.1 + best.2) / 2.0 + 1.0) / BINS as f64
}

fn bytes(vector: [f32; 3]) -> [u8; 12] {
    let mut found = [0; 12];
    found.as_chunks_mut::<4>().0.iter_mut().zip(vector).for_each(|(part, value)| *part = value.to_le_bytes());
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;
    use std::f64::consts::PI;

    /// Depth below the surface of a ball, in voxels, in a volume of unequal sides.
    fn ball(shape: [usize; 3], centre: DVec3, radius: f64) -> VolumeFile {
        let depth = |(x, y, z)| (radius - DVec3::new(x as f64, y as f64, z as f64).distance(centre)) as f32;
        VolumeFile { values: Array3::from_shape_fn(shape, depth), ..VolumeFile::default() }
    }

    /// Every edge has two triangles, which pass it in opposite directions.
    fn assert_closed(mesh: &Mesh) {
        let mut edges = HashMap::new();
        for [a, b, c] in &mesh.triangles {
            for edge in [[a, b], [b, c], [c, a]] {
                *edges.entry(edge).or_insert(0) += 1;
            }
        }
        assert!(!edges.is_empty() && edges.values().all(|&count| count == 1), "an edge is passed twice");
        assert!(edges.keys().all(|[a, b]| edges.contains_key(&[*b, *a])), "an edge has one triangle");
    }

    #[test]
    fn a_sphere_is_closed_outward_and_has_its_volume() {
        for directions in [DMat3::IDENTITY, DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0))] {
            let mut file = ball([60, 64, 68], DVec3::new(29.3, 31.8, 33.1), 25.0);
            file.directions = directions;
            file.unit = Some(Unit::Centimetre);
            file.spacing = Some(DVec3::splat(0.2));
            file.origin = Some(DVec3::new(1.0, 2.0, 3.0));
            let mesh = Mesh::of(&file, 0.0).unwrap();
            assert_closed(&mesh);
            // 2 mm a voxel.
            within!("volume", (mesh.volume() / (4.0 / 3.0 * PI * 125e3) - 1.0).abs());
            let middle = (directions * DVec3::new(29.3, 31.8, 33.1) * 2.0 + DVec3::new(10.0, 20.0, 30.0)).as_vec3();
            let distance = |at: &Vec3| f64::from((at.distance(middle) - 50.0).abs());
            within!("radius", mesh.positions.iter().map(distance).fold(0.0, f64::max));
            let outward = |(at, normal): (&Vec3, &Vec3)| f64::from((*at - middle).normalize().dot(*normal));
            beyond!("normal", mesh.positions.iter().zip(&mesh.normals).map(outward).fold(1.0, f64::min));
        }
    }

    #[test]
    fn an_object_that_leaves_the_volume_is_closed_at_the_faces_of_voxels() {
        let file = VolumeFile { values: Array3::ones((4, 5, 6)), ..VolumeFile::default() };
        let mesh = Mesh::of(&file, 0.5).unwrap();
        assert_closed(&mesh);
        let ends = |start: f32, of: fn(Vec3, Vec3) -> Vec3| mesh.positions.iter().copied().fold(Vec3::splat(start), of);
        assert_eq!(ends(9.0, Vec3::min).to_array(), [-0.5; 3]);
        assert_eq!(ends(-9.0, Vec3::max).to_array(), [3.5, 4.5, 5.5]);
        // Edges of the box are bevelled.
        within!((mesh.volume() / 120.0 - 1.0).abs());
        assert_closed(&Mesh::of(&ball([20, 20, 20], DVec3::new(2.0, 10.0, 19.0), 7.5), 0.0).unwrap());
    }

    #[test]
    fn files_hold_the_mesh() {
        let folder = tempfile::tempdir().unwrap();
        let file = VolumeFile { unit: Some(Unit::Millimetre), ..ball([12, 13, 14], DVec3::splat(6.0), 4.0) };
        let mesh = Mesh::of(&file, 0.0).unwrap();
        let written = |name: &str| {
            let path = folder.path().join(name);
            mesh.write(&path).unwrap();
            std::fs::read(path).unwrap()
        };
        let stl = written("ball.stl");
        assert_eq!(stl.len(), 84 + 50 * mesh.triangles.len());
        let number = |at: usize| f32::from_le_bytes(stl[at..at + 4].try_into().unwrap());
        let first = mesh.positions[mesh.triangles[0][0] as usize];
        assert_eq!([number(96), number(100), number(104)], first.to_array());
        let ply = written("ball.ply");
        let header = String::from_utf8_lossy(&ply[..400]);
        let (vertices, faces) = (mesh.positions.len(), mesh.triangles.len());
        for line in [format!("element vertex {vertices}\n"), format!("element face {faces}\n"), "millimetres\n".into()]
        {
            assert!(header.contains(&line), "{line} in {header}");
        }
        let glb = written("ball.glb");
        let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&glb[..4], word(4), word(8), &glb[16..20]), (b"glTF".as_slice(), 2, glb.len(), JSON.as_slice()));
        let json: serde_json::Value = serde_json::from_slice(&glb[20..20 + word(12)]).unwrap();
        let binary = 20 + word(12) + 8;
        assert_eq!((word(12) % 4, json["buffers"][0]["byteLength"].as_u64()), (0, Some((glb.len() - binary) as u64)));
        assert_eq!(json["accessors"][2]["count"], 3 * faces);
        assert_eq!(glb[binary..binary + 12], bytes(mesh.positions[0].to_array()));
    }

    #[test]
    fn the_level_lies_between_two_classes() {
        let values = Array3::from_shape_fn(
            (10, 10, 10),
            |(x, y, _)| if x < 7 { 0.01 * y as f32 } else { 1.0 + 0.01 * y as f32 },
        );
        let level = otsu(&VolumeFile { values, ..VolumeFile::default() });
        // In the middle of the gap from 0.09 to 1.
        within!((level - 0.545).abs());
        let flat = VolumeFile { values: Array3::ones((2, 2, 2)), ..VolumeFile::default() };
        assert_eq!(otsu(&flat), 1.0);
        for level in [1.0, f64::NAN] {
            let error = Mesh::of(&flat, level).unwrap_err().to_string();
            assert!(error.contains("expected less than 1, the highest value"), "{error}");
        }
    }
}
