//! Memory of the vertices and indices of a surface's regions.

use bytemuck::Pod;
use bytes::Bytes;
use std::fmt;
use std::ops::Deref;

/// Elements in a vector of their own, or in memory that the device wrote and that regions and clones share; this memory is released
/// when the last of them is dropped. A typed view of [`Bytes`], which itself guarantees no alignment.
#[derive(Clone)]
pub struct SharedSlice<T>(Memory<T>);

#[derive(Clone)]
enum Memory<T> {
    Owned(Vec<T>),
    /// A whole number of elements, aligned for them.
    Shared(Bytes),
}

impl<T: Pod> SharedSlice<T> {
    /// Elements in shared memory.
    ///
    /// # Panics
    /// Bytes that are not a whole number of aligned elements.
    pub(crate) fn new(bytes: Bytes) -> Self {
        Self::of_bytes(bytes).expect("aligned elements")
    }

    /// Elements in shared memory; `None` if the bytes are not a whole number of aligned elements.
    pub fn of_bytes(bytes: Bytes) -> Option<Self> {
        let fits = bytemuck::try_cast_slice::<u8, T>(&bytes).is_ok();
        fits.then_some(Self(Memory::Shared(bytes)))
    }

    /// The same bits as elements of another type, of the same size and alignment.
    pub(crate) fn cast<U: Pod>(self) -> SharedSlice<U> {
        const { assert!(size_of::<T>() == size_of::<U>() && align_of::<T>() == align_of::<U>()) };
        SharedSlice(match self.0 {
            Memory::Owned(vec) => Memory::Owned(bytemuck::cast_vec(vec)),
            Memory::Shared(bytes) => Memory::Shared(bytes),
        })
    }

    /// The elements for writing; shared ones are copied first.
    pub fn to_mut(&mut self) -> &mut Vec<T> {
        if let Memory::Shared(_) = self.0 {
            self.0 = Memory::Owned(self.to_vec());
        }
        match &mut self.0 {
            Memory::Owned(vec) => vec,
            Memory::Shared(_) => unreachable!("owned since the line above"),
        }
    }
}

impl<T: Pod> Deref for SharedSlice<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        match &self.0 {
            Memory::Owned(vec) => vec,
            Memory::Shared(bytes) => bytemuck::cast_slice(bytes),
        }
    }
}

impl<T> Default for SharedSlice<T> {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl<T> From<Vec<T>> for SharedSlice<T> {
    fn from(vec: Vec<T>) -> Self {
        Self(Memory::Owned(vec))
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for SharedSlice<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.deref().fmt(f)
    }
}

impl<T: Pod + PartialEq> PartialEq for SharedSlice<T> {
    fn eq(&self, other: &Self) -> bool {
        self.deref() == other.deref()
    }
}

impl<'a, T: Pod> IntoIterator for &'a SharedSlice<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::SharedSlice;
    use bytes::Bytes;
    use std::sync::Arc;

    struct Owner(Arc<Vec<u32>>);

    impl AsRef<[u8]> for Owner {
        fn as_ref(&self) -> &[u8] {
            bytemuck::cast_slice(&self.0)
        }
    }

    #[test]
    fn shared_elements_are_copied_before_they_change_and_freed_with_the_last_part() {
        let memory = Arc::new(vec![1u32, 2, 3, 4]);
        let part = SharedSlice::<u32>::new(Bytes::from_owner(Owner(memory.clone())).slice(4..12));
        let mut changed = part.clone();
        assert_eq!((&*part, Arc::strong_count(&memory)), (&[2, 3][..], 2));
        changed.to_mut().push(7);
        assert_eq!((&*changed, &*part), (&[2, 3, 7][..], &[2, 3][..]));
        assert!(part == vec![2, 3].into());
        drop(part);
        assert_eq!(Arc::strong_count(&memory), 1);
    }

    #[test]
    #[should_panic(expected = "aligned elements")]
    fn half_an_element_is_refused() {
        let _ = SharedSlice::<u32>::new(Bytes::from_owner(Owner(Arc::new(vec![0, 0]))).slice(0..6));
    }
}
