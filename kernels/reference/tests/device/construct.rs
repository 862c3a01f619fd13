//! Nodes of every level, and the vertices that the dual mesher takes.

use super::recipes::{Pattern, any_recipe, kinds};
use super::*;
use isopeel_kernels::SampleType;
use isopeel_reference::construct;
use isopeel_reference::octahedral;
use isopeel_reference::vertices::{DualVertex, DualVertices, vertices};

/// The feature of a pyramid.
#[derive(Clone, Debug)]
enum FeatureRecipe {
    None,
    Gradient,
    Other(Recipe),
}

fn with_features(of: Recipe) -> impl Strategy<Value = (Recipe, FeatureRecipe)> {
    let other = (kinds(), any::<u64>(), any::<bool>()).prop_map({
        let of = of.clone();
        move |(kind, seed, missing)| {
            FeatureRecipe::Other(Recipe {
                kind,
                seed,
                missing,
                pattern: Pattern::Waves(30),
                ..of.clone()
            })
        }
    });
    (
        Just(of),
        prop_oneof![1 => Just(FeatureRecipe::None), 1 => Just(FeatureRecipe::Gradient), 2 => other],
    )
}

/// Runs `body` with the device's and the twin's form of a feature.
fn with_feature<T>(
    engine: &Engine,
    of: &FeatureRecipe,
    body: impl FnOnce(Feature<'_>, construct::Feature<'_>) -> T,
) -> T {
    match of {
        FeatureRecipe::None => body(Feature::None, construct::Feature::None),
        FeatureRecipe::Gradient => body(
            Feature::Derived(DerivedFeature::GradientMagnitude),
            construct::Feature::Derived(DerivedFeature::GradientMagnitude),
        ),
        FeatureRecipe::Other(recipe) => {
            let other = load(engine, recipe);
            body(Feature::Field(&other.volume), construct::Feature::Field(&other.field))
        }
    }
}

fn check_nodes(
    host: &HostPyramid,
    twin: &Twin,
    vertices: &DualVertices,
    pyramid: &Pyramid,
) -> Result<(), TestCaseError> {
    prop_assert_eq!(pyramid.full_triangles(), twin.full_triangles());
    for (slot, (node, leaf)) in host.nodes.iter().zip(&host.leaves).enumerate() {
        if host.is_extra(slot) {
            let sheet = node.meta >> 26 & 3;
            prop_assert!((1..u32::from(vertices.sheets[&leaf.cube].count)).contains(&sheet));
            continue;
        }
        let Some(want) = twin.nodes[usize::from(leaf.level)].get(&leaf.cube) else {
            prop_assert_eq!(node.count, 0, "{:?} has no active cell", leaf);
            prop_assert!(leaf.level >= 3);
            continue;
        };
        let (signs, missing) = ((node.meta >> 16 & 0xff) as u8, node.meta >> 24 & 1 == 1);
        let triangles = if leaf.level == 0 { node.count & 0xff } else { node.count };
        prop_assert_eq!(
            (triangles, signs, missing),
            (want.count, want.signs, want.missing),
            "{:?}",
            leaf
        );
        prop_assert!(
            (node.s - want.s).abs() <= 2e-5,
            "s of {:?} is {}, expected {}",
            leaf,
            node.s,
            want.s
        );
        prop_assert!(
            near(node.f, want.f, 2e-5),
            "f of {:?} is {}, expected {}",
            leaf,
            node.f,
            want.f
        );
        if leaf.level > 0 {
            let safe = node.meta >> 25 & 1 == 1;
            prop_assert_eq!(safe, vertices.safe.contains(leaf), "{:?} is safe to merge", leaf);
        } else {
            prop_assert_eq!((node.meta >> 26 & 3) as u8 + 1, vertices.sheets[&leaf.cube].count);
        }
    }
    for brick in &host.bricks {
        let first = (host.regions[brick.region as usize].slot_base + brick.level_base[3]) as usize;
        for extra in 0..brick.extra_sheets {
            let slot = first + extra as usize;
            let begin = host.nodes[host.slots[&host.leaves[slot]]].count >> 8;
            let sheet = host.nodes[slot].meta >> 26 & 3;
            prop_assert_eq!(begin + sheet - 1, extra, "sheet {} of {:?}", sheet, host.leaves[slot]);
        }
    }
    let of_twin: usize = twin.nodes.iter().map(|n| n.len()).sum();
    let extras: usize = vertices.sheets.values().map(|s| usize::from(s.count) - 1).sum();
    let empty = host.nodes.iter().filter(|n| n.count == 0).count();
    prop_assert_eq!(host.nodes.len(), of_twin + extras + empty);
    Ok(())
}

/// How a slot's vertex compares.
struct Compared<'a> {
    host: &'a HostPyramid,
    field: &'a Field,
    slot: usize,
    leaf: Leaf,
    want: DualVertex,
}

impl Compared<'_> {
    /// Cells along the side of the cube.
    fn reach(&self) -> f64 {
        f64::from(1u32 << self.leaf.level)
    }

    /// Returns whether the position agrees within rounding. Fails if it lies outside the cube.
    fn is_near(&self) -> Result<bool, TestCaseError> {
        let [low, high] = self.field.cube_samples(usize::from(self.leaf.level), self.leaf.cube);
        let spacing = self.field.grid.spacing;
        let longest = spacing.into_iter().fold(0.0, f32::max);
        let mut is_near = true;
        for (axis, lattice) in self.host.position(self.slot).into_iter().enumerate() {
            let at = lattice as f64 / f64::from(Vertex::LATTICE);
            prop_assert!(
                at > f64::from(low[axis]) && at < f64::from(high[axis]),
                "the vertex of {:?} at {} along axis {}",
                self.leaf,
                at,
                axis
            );
            // Rounded once by `construct`, a cell's once more after relaxation: an error along the longest axis is more cells
            // along a shorter one.
            let stretch = if self.leaf.level == 0 {
                f64::from(longest / spacing[axis])
            } else {
                1.0
            };
            let tolerance =
                (1.0 + 1.5 * stretch) / 2048.0 + 2e-4 * self.reach() + 2.0 * stretch * self.want.uncertainty;
            is_near &= (at - self.want.position[axis]).abs() <= tolerance;
        }
        Ok(is_near)
    }

    /// `is_optional`: nothing reads the error of one of several sheets, for a cell is never refused.
    fn check_error(&self, is_optional: bool) -> Result<(), TestCaseError> {
        let got = self.host.vertex_records[self.slot].error;
        // The quadric's constant term counts distances from the middle of the brick or region.
        let spacing = self.field.grid.spacing.iter().fold(0.0f64, |m, &s| m.max(s.into()));
        let far = spacing * if self.leaf.level > 3 { 28.0 } else { 7.0 };
        let (want, step) = (self.want.error, 2e-3 * self.reach() * spacing);
        let tolerance = 2e-6 * far * far + step * (want + step);
        let is_near = (f64::from(got).powi(2) - want.powi(2)).abs() <= tolerance;
        prop_assert!(
            is_near || (is_optional && got == 0.0),
            "{:?}: error {}, expected {}",
            self.leaf,
            got,
            want
        );
        Ok(())
    }

    fn check_normal(&self) -> Result<(), TestCaseError> {
        let bytes = self.host.vertex_records[self.slot].normal.to_le_bytes();
        let got = octahedral::decode(bytes.map(|b| f32::from(b.cast_signed()) / 127.0));
        let length = self.want.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let along = got.iter().zip(self.want.gradient).map(|(n, g)| -f64::from(*n) * g);
        let cosine = along.sum::<f64>() / length;
        // If the gradients below nearly cancel out, rounding decides.
        let is_certain = length > 0.05 * f64::from(self.host.nodes[self.slot].count);
        prop_assert!(
            !is_certain || cosine > 0.998,
            "{:?}: normal off by {} degrees",
            self.leaf,
            cosine.acos().to_degrees()
        );
        Ok(())
    }
}

/// Positions agree within the lattice's rounding if the Newton steps do not jump; errors agree within the rounding of f32 sums.
///
/// On a plateau the gradient is zero within rounding, so a Newton step may go anywhere: `plateaus` allows one such vertex in a hundred.
fn check_vertices(
    host: &HostPyramid,
    field: &Field,
    vertices: &DualVertices,
    plateaus: bool,
) -> Result<(), TestCaseError> {
    let mut elsewhere = Vec::new();
    for (slot, &leaf) in host.leaves.iter().enumerate() {
        if host.nodes[slot].count == 0 {
            continue;
        }
        let (_, sheet, _) = host.corner(slot);
        let want = vertices.vertices[&(leaf, sheet)];
        let compared = Compared {
            host,
            field,
            slot,
            leaf,
            want,
        };
        if !compared.is_near()? {
            elsewhere.push((leaf, sheet, host.position(slot), want));
        } else if want.uncertainty < 1e-3 {
            compared.check_error(leaf.level == 0 && vertices.sheets[&leaf.cube].count > 1)?;
            if leaf.level > 0 {
                compared.check_normal()?;
            }
        }
    }
    let allowed = if plateaus { 1 + host.leaves.len() / 100 } else { 0 };
    prop_assert!(
        elsewhere.len() <= allowed,
        "{} vertices of {} lie elsewhere, the first: {:?}",
        elsewhere.len(),
        host.leaves.len(),
        elsewhere[0]
    );
    Ok(())
}

#[test]
fn nodes_and_vertices_are_the_twins() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |((recipe, feature) in any_recipe().prop_flat_map(with_features))| {
        let loaded = load(&engine, &recipe);
        with_feature(&engine, &feature, |feature, twin_feature| {
            let pyramid = build(&engine, &loaded, feature);
            let host = HostPyramid::read(&engine, &pyramid);
            let twin = construct::construct(&loaded.field, twin_feature, loaded.iso);
            let vertices = vertices(&loaded.field, &twin, loaded.iso);
            check_nodes(&host, &twin, &vertices, &pyramid)?;
            // Infinities have no planes to fit.
            if recipe.pattern == Pattern::Extremes && recipe.kind == SampleType::F32 {
                return Ok(());
            }
            check_vertices(&host, &loaded.field, &vertices, !matches!(recipe.pattern, Pattern::Waves(0)))
        })?;
    });
}
