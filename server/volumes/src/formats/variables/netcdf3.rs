//! NetCDF-3, in the versions 1 (classic), 2 (64-bit offset) and 5 (64-bit data), by the crate `netcdf-reader`.

use std::collections::HashSet;
use std::ops::Range;
use std::sync::Arc;

use bytemuck::Pod;
use hdf5_reader::Storage;
use netcdf_reader::classic::ClassicFile;
use netcdf_reader::classic::data::NcReadType;
use netcdf_reader::{NcAttrValue, NcFormat, NcSliceInfo, NcSliceInfoElem, NcType, NcVariable};

use super::super::super::stored::{Endian, StoredType};
use super::file::{ATTRIBUTES, Attribute, Attributes, Axis, AxisLabel, Variable, VariableFile};

/// A NetCDF-3 file.
pub struct NetCdf3 {
    file: ClassicFile,
    file_bytes: u64,
    /// Names of the variables with the positions along the dimension of the same name.
    scales: HashSet<String>,
}

impl NetCdf3 {
    /// Reads the header. `version` is the fourth byte of the file.
    pub fn open(storage: Arc<dyn Storage>, version: u8) -> Result<Self, String> {
        let format = match version {
            1 => NcFormat::Classic,
            2 => NcFormat::Offset64,
            _ => NcFormat::Cdf5,
        };
        let file_bytes = storage.len();
        let file = ClassicFile::from_storage(storage, format).map_err(|e| e.to_string())?;
        let is_scale = |v: &&NcVariable| v.dimensions.len() == 1 && v.dimensions[0].name == v.name;
        let scales = file.root_group().variables.iter().filter(is_scale);
        Ok(Self {
            scales: scales.map(|v| v.name.clone()).collect(),
            file,
            file_bytes,
        })
    }

    fn describe(&self, variable: &NcVariable) -> Variable {
        let scale = |name: &str| self.scales.contains(name).then(|| format!("/{name}"));
        let axes = variable.dimensions.iter().map(|dimension| Axis {
            dimension: Some(format!("/{}", dimension.name)),
            scale: scale(&dimension.name),
            label: AxisLabel::default(),
            size: dimension.size,
            is_unlimited: dimension.is_unlimited,
        });
        let attributes = variable.attributes.iter();
        let mut variable = Variable {
            path: format!("/{}", variable.name),
            axes: axes.collect(),
            stored: stored_type(&variable.dtype),
            // The library converts samples to the machine's byte order.
            endian: Endian::NATIVE,
            attributes: Attributes(
                attributes
                    .filter(|attribute| ATTRIBUTES.contains(&attribute.name.as_str()))
                    .filter_map(|attribute| Some((attribute.name.clone(), value(&attribute.value)?)))
                    .collect(),
            ),
            chunk: None,
            plain: (!variable.is_record_var).then_some((variable.data_offset, Endian::Big)),
            is_scale: scale(&variable.name).is_some(),
            is_netcdf: true,
        };
        if variable.bytes().is_none_or(|bytes| bytes > self.file_bytes) {
            let (shape, have) = (variable.shape(), self.file_bytes);
            let why = format!("{shape} samples, which a file of {have} bytes cannot hold");
            variable.stored = variable.stored.and(Err(why));
        }
        variable
    }
}

impl VariableFile for NetCdf3 {
    fn variables(&self) -> Vec<Variable> {
        let variables = self.file.root_group().variables.iter();
        variables.map(|variable| self.describe(variable)).collect()
    }

    fn variable(&self, path: &str) -> Result<Variable, String> {
        let mut variables = self.file.root_group().variables.iter();
        variables
            .find(|variable| path.strip_prefix('/') == Some(&variable.name))
            .map(|variable| self.describe(variable))
            .ok_or_else(|| "not there".into())
    }

    fn read(&self, variable: &Variable, selection: &[Range<u64>]) -> Result<Vec<u8>, String> {
        let path = &variable.path;
        match variable.stored.clone()? {
            StoredType::U8 => self.read_box::<u8>(path, selection),
            StoredType::I8 => self.read_box::<i8>(path, selection),
            StoredType::U16 => self.read_box::<u16>(path, selection),
            StoredType::I16 => self.read_box::<i16>(path, selection),
            StoredType::U32 => self.read_box::<u32>(path, selection),
            StoredType::I32 => self.read_box::<i32>(path, selection),
            StoredType::U64 => self.read_box::<u64>(path, selection),
            StoredType::I64 => self.read_box::<i64>(path, selection),
            StoredType::F16 => Err("half floats, which NetCDF-3 does not have".into()),
            StoredType::F32 => self.read_box::<f32>(path, selection),
            StoredType::F64 => self.read_box::<f64>(path, selection),
        }
    }
}

impl NetCdf3 {
    fn read_box<T: NcReadType + Pod>(&self, path: &str, selection: &[Range<u64>]) -> Result<Vec<u8>, String> {
        let selections = selection.iter().map(|range| NcSliceInfoElem::Slice {
            start: range.start,
            end: range.end,
            step: 1,
        });
        let selection = NcSliceInfo {
            selections: selections.collect(),
        };
        let values = self.file.read_variable_slice_parallel::<T>(path, &selection);
        let (values, _) = values.map_err(|e| e.to_string())?.into_raw_vec_and_offset();
        Ok(bytemuck::cast_slice(&values).to_vec())
    }
}

fn stored_type(kind: &NcType) -> Result<StoredType, String> {
    Ok(match kind {
        NcType::Byte => StoredType::I8,
        NcType::UByte => StoredType::U8,
        NcType::Short => StoredType::I16,
        NcType::UShort => StoredType::U16,
        NcType::Int => StoredType::I32,
        NcType::UInt => StoredType::U32,
        NcType::Int64 => StoredType::I64,
        NcType::UInt64 => StoredType::U64,
        NcType::Float => StoredType::F32,
        NcType::Double => StoredType::F64,
        _ => return Err("text, expected numbers".into()),
    })
}

fn value(value: &NcAttrValue) -> Option<Attribute> {
    match value.as_string() {
        Some(text) => Some(Attribute::Text(text)),
        None => Some(Attribute::Numbers(value.as_f64_vec()?, type_of(value))),
    }
}

fn type_of(value: &NcAttrValue) -> Option<StoredType> {
    Some(match value {
        NcAttrValue::Bytes(_) => StoredType::I8,
        NcAttrValue::UBytes(_) => StoredType::U8,
        NcAttrValue::Shorts(_) => StoredType::I16,
        NcAttrValue::UShorts(_) => StoredType::U16,
        NcAttrValue::Ints(_) => StoredType::I32,
        NcAttrValue::UInts(_) => StoredType::U32,
        NcAttrValue::Int64s(_) => StoredType::I64,
        NcAttrValue::UInt64s(_) => StoredType::U64,
        NcAttrValue::Floats(_) => StoredType::F32,
        NcAttrValue::Doubles(_) => StoredType::F64,
        NcAttrValue::Chars(_) | NcAttrValue::Strings(_) | NcAttrValue::UserDefined { .. } => return None,
    })
}
