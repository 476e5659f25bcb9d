//! Answers to the stages of networks.

use super::manifest::Arrays;
use super::outputs::{Outputs, one, two};
use super::question::Question;
use ndarray::{Ix2, Ix3};
use trgs_core::error::Result;
use trgs_core::numeric::Real;
use trgs_methods::neural::conformance;

fn level(q: &Question) -> Result<[u32; 2]> {
    Ok([q.integer("resolution")? as u32, q.integer("entries")? as u32])
}

pub(super) fn corners<R: Real>(q: &Question) -> Result<Outputs> {
    let ([resolution, entries], points) = (level(q)?, q.array::<Ix2>("points")?);
    let [entry, weight] = conformance::corners::<R>(resolution, entries, points.view());
    Ok(two(("entry", entry), ("weight", weight)))
}

pub(super) fn hash_code<R: Real>(q: &Question) -> Result<Outputs> {
    let ([resolution, _], points, table) = (level(q)?, q.array::<Ix2>("points")?, q.array::<Ix2>("table")?);
    Ok(one("code", conformance::hash_code::<R>(resolution, table.view(), points.view())))
}

pub(super) fn hash_code_vjp<R: Real>(q: &Question) -> Result<Outputs> {
    let ([resolution, entries], points) = (level(q)?, q.array::<Ix2>("points")?);
    let cotangent = q.array::<Ix2>("cotangent")?;
    Ok(one("gradient", conformance::hash_code_vjp::<R>(resolution, entries, points.view(), cotangent.view())))
}

pub(super) fn frequency_code<R: Real>(q: &Question) -> Result<Outputs> {
    let (frequencies, sides, points) =
        (q.integer("frequencies")? as usize, q.triple("half_sides")?, q.array::<Ix2>("points")?);
    Ok(one("code", conformance::frequency_code::<R>(frequencies, sides, points.view())))
}

pub(super) fn lineformer<R: Real>(q: &Question) -> Result<Outputs> {
    let parameters = q.joined("parameters", conformance::lineformer_parts())?;
    Ok(one("value", conformance::lineformer::<R>(&parameters, q.array::<Ix3>("x")?.view())))
}

pub(super) fn lineformer_vjp<R: Real>(q: &Question) -> Result<Outputs> {
    let parameters = q.joined("parameters", conformance::lineformer_parts())?;
    let (x, cotangent) = (q.array::<Ix3>("x")?, q.array::<Ix3>("cotangent")?);
    let (gradient, to_x) = conformance::lineformer_vjp::<R>(&parameters, x.view(), cotangent.view());
    let mut arrays: Arrays = gradient.into_iter().collect();
    arrays.insert("x".to_owned(), to_x.into_dyn());
    Ok([("grad".to_owned(), arrays)].into())
}

pub(super) fn quadrature(q: &Question) -> Result<Outputs> {
    let [pixels, draws, density] = [q.array::<Ix2>("pixels")?, q.array::<Ix2>("draws")?, q.array::<Ix2>("density")?];
    let found = conformance::quadrature(&q.scanner()?, &q.angles()?, pixels.view(), draws.view(), density.view())?;
    let mut all = two(("point", found.points), ("length", found.lengths));
    all.extend(one("integral", found.integrals));
    Ok(all)
}
