//! What a surface's regions hold their vertices and indices in.

use bytemuck::Pod;
use std::any::Any;
use std::fmt;
use std::ops::Deref;
use std::ptr::NonNull;
use std::sync::Arc;

/// Elements that lie in a vector of their own, or in memory that all regions of a surface, or many of them, and their clones share:
/// the device wrote them there, and it is free again when the last is dropped.
pub struct SharedSlice<T>(Memory<T>);

enum Memory<T> {
    Own(Vec<T>),
    Shared(Part<T>),
}

/// `len` elements in memory that stays where it is, and is not written to, as long as `owner` lives.
struct Part<T> {
    first: NonNull<T>,
    len: usize,
    owner: Arc<dyn Any + Send + Sync>,
}

// SAFETY: a part only reads what its owner, which may be sent and shared, keeps in place.
unsafe impl<T: Sync> Send for Part<T> {}
// SAFETY: as above.
unsafe impl<T: Sync> Sync for Part<T> {}

impl<T> SharedSlice<T> {
    /// # Safety
    /// `first` must point to `len` elements that stay where they are, and are not written to, as long as `owner` lives.
    pub(crate) unsafe fn new(first: NonNull<T>, len: usize, owner: Arc<dyn Any + Send + Sync>) -> Self {
        Self(Memory::Shared(Part { first, len, owner }))
    }
}

impl<T: Pod> SharedSlice<T> {
    /// The same bits as elements of another type, of the same size and alignment.
    pub(crate) fn cast<U: Pod>(self) -> SharedSlice<U> {
        const { assert!(size_of::<T>() == size_of::<U>() && align_of::<T>() == align_of::<U>()) };
        SharedSlice(match self.0 {
            Memory::Own(vec) => Memory::Own(bytemuck::cast_vec(vec)),
            Memory::Shared(Part { first, len, owner }) => Memory::Shared(Part {
                first: first.cast(),
                len,
                owner,
            }),
        })
    }
}

impl<T: Clone> SharedSlice<T> {
    /// To change the elements: where they are shared, they are copied first.
    pub fn to_mut(&mut self) -> &mut Vec<T> {
        if let Memory::Shared(_) = self.0 {
            self.0 = Memory::Own(self.to_vec());
        }
        match &mut self.0 {
            Memory::Own(vec) => vec,
            Memory::Shared(_) => unreachable!("owned since the line above"),
        }
    }
}

impl<T> Deref for SharedSlice<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.0 {
            Memory::Own(vec) => vec,
            // SAFETY: as promised to `new`.
            Memory::Shared(part) => unsafe { std::slice::from_raw_parts(part.first.as_ptr(), part.len) },
        }
    }
}

impl<T: Clone> Clone for SharedSlice<T> {
    fn clone(&self) -> Self {
        Self(match &self.0 {
            Memory::Own(vec) => Memory::Own(vec.clone()),
            &Memory::Shared(Part { first, len, ref owner }) => Memory::Shared(Part {
                first,
                len,
                owner: owner.clone(),
            }),
        })
    }
}

impl<T> Default for SharedSlice<T> {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl<T> From<Vec<T>> for SharedSlice<T> {
    fn from(vec: Vec<T>) -> Self {
        Self(Memory::Own(vec))
    }
}

impl<T: fmt::Debug> fmt::Debug for SharedSlice<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.deref().fmt(f)
    }
}

impl<T: PartialEq> PartialEq for SharedSlice<T> {
    fn eq(&self, other: &Self) -> bool {
        self.deref() == other.deref()
    }
}

impl<'a, T> IntoIterator for &'a SharedSlice<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::SharedSlice;
    use std::ptr::NonNull;
    use std::sync::Arc;

    #[test]
    fn shared_elements_are_copied_before_they_change_and_freed_with_the_last_part() {
        let owner = Arc::new(vec![1, 2, 3, 4]);
        let first = NonNull::from(&owner[1]);
        // SAFETY: elements 1 and 2 of a vector that is not written to.
        let part = unsafe { SharedSlice::new(first, 2, owner.clone()) };
        let mut changed = part.clone();
        assert_eq!((&*part, Arc::strong_count(&owner)), (&[2, 3][..], 3));
        changed.to_mut().push(7);
        assert_eq!((&*changed, &*part), (&[2, 3, 7][..], &[2, 3][..]));
        assert_eq!((Arc::strong_count(&owner), part == vec![2, 3].into()), (2, true));
        drop(part);
        assert_eq!(Arc::strong_count(&owner), 1);
    }
}
