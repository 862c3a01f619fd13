//! Fields that an expression over resident ones gives.

use crate::program::Program;
use crate::stages::evaluate;
use crate::volume::{Slab, slab_planes};
use crate::{Cancel, Engine, Error, Expression, Result, SampleType, Volume, constants};
use std::cell::RefCell;
use std::rc::Rc;

/// Programs of expressions that are kept, each of some 10 kB: more than viewers change between.
const MAX_PROGRAMS: usize = 64;

/// Programs by their text, the one used last at the end.
pub(super) struct Programs<P = Program> {
    kept: RefCell<Vec<(String, Rc<P>)>>,
}

impl<P> Programs<P> {
    pub(super) const fn new() -> Self {
        Self {
            kept: RefCell::new(Vec::new()),
        }
    }

    /// The program of this text, which is built where it is not kept.
    pub(super) fn get(&self, text: &str, build: impl FnOnce() -> Result<P>) -> Result<Rc<P>> {
        let mut kept = self.kept.borrow_mut();
        if let Some(at) = kept.iter().position(|(own, _)| own == text) {
            kept[at..].rotate_left(1);
        } else {
            let program = Rc::new(build()?);
            if kept.len() == MAX_PROGRAMS {
                kept.remove(0);
            }
            kept.push((text.to_owned(), program));
        }
        // There is one: it was put there, or found.
        Ok(Rc::clone(&kept[kept.len() - 1].1))
    }
}

impl Engine {
    /// The field that an expression gives, of f32. `fields`: those of the expression, in the order of their places.
    ///
    /// # Errors
    /// Fewer fields than it has, or other grids; [`Error::Cancelled`]; or what the device says.
    pub fn evaluate(&self, expression: &Expression, fields: &[&Volume], cancel: &dyn Cancel) -> Result<Volume> {
        let slabs = self.evaluate_slabs(expression, fields, cancel)?;
        // There is one: an expression has a field.
        let (grid, lengths) = (fields[0].grid, fields[0].inverse_lengths.clone());
        self.resident(grid, SampleType::F32, None, slabs, lengths)
    }

    /// The samples of the field that an expression gives.
    pub(super) fn evaluate_slabs(
        &self,
        expression: &Expression,
        fields: &[&Volume],
        cancel: &dyn Cancel,
    ) -> Result<Vec<Slab>> {
        let fail = |why: String| {
            Err(Error::Invalid {
                what: "expression",
                why,
            })
        };
        let count = expression.fields();
        let Some((first, fields)) = fields.first().zip(fields.get(..count)) else {
            return fail(format!("{} fields, expected {count}", fields.len()));
        };
        let grid = first.grid;
        if let Some(other) = fields.iter().find(|field| field.grid != grid) {
            return fail(format!(
                "fields of {:?} and {:?} samples, expected one grid",
                grid.dims, other.grid.dims
            ));
        }
        let field = |i: usize| fields.get(i).unwrap_or(first);
        let mut text = expression.code();
        for i in 0..constants::EXPRESSION_FIELDS as usize {
            text += &format!(
                "#define FIELD_{i} {}\n",
                crate::program::sample_type_name(field(i).sample_type)
            );
        }
        text += &format!("#define FIELDS {count}\n#include \"evaluate.cl\"\n");
        // Of any type: headers want one.
        let build = || self.cx.build(&text, "-cl-std=CL1.2 -DSAMPLE=float");
        let program = self.expressions.get(&text, build)?;
        let plane = grid.dims[0] as usize * grid.dims[1] as usize * SampleType::F32.bytes();
        let mut slabs = Vec::new();
        // Fields of one grid have the same slabs.
        for (number, Slab { layers, .. }) in first.slabs.iter().enumerate() {
            let planes = slab_planes(&grid, layers);
            let samples = self.cx.buffer(evaluate::STAGE, planes.len() * plane)?;
            let inputs = std::array::from_fn(|i| (&field(i).slabs[number].samples, field(i).missing));
            let grid = first.layout();
            evaluate::run(&self.cx, &program, &grid, inputs, &samples, planes.clone(), cancel)?;
            slabs.push(Slab {
                samples,
                z0: planes.start,
                layers: layers.clone(),
            });
        }
        Ok(slabs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_programs_used_last_are_kept() {
        let programs: Programs<usize> = Programs::new();
        let built = std::cell::Cell::new(0);
        let get = |n: usize| {
            let build = || {
                built.set(built.get() + 1);
                Ok(n)
            };
            assert_eq!(*programs.get(&n.to_string(), build).expect("built"), n);
        };
        (0..MAX_PROGRAMS).for_each(get);
        get(0);
        assert_eq!(built.get(), MAX_PROGRAMS);
        // The second one goes.
        get(MAX_PROGRAMS);
        get(0);
        assert_eq!(built.get(), MAX_PROGRAMS + 1);
        get(1);
        assert_eq!(
            (built.get(), programs.kept.borrow().len()),
            (MAX_PROGRAMS + 2, MAX_PROGRAMS)
        );
    }
}
