//! Pickles that hold only data, protocols 2 to 5: numbers, texts, lists, dictionaries, NumPy arrays.
//!
//! A pickle is a program for a stack machine, and Python runs whatever functions it names. This reader knows the few
//! functions that NumPy uses to describe arrays, and interprets them itself. Whatever another function or class would
//! make becomes [`Value::Unknown`], so that entries that nobody needs do no harm. Memory is bounded by the file: arrays are copied from its bytes, never allocated by a stated shape.

mod number;

use number::Number;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;
use trgs_core::error::{Error, Result};

/// Largest nesting depth of objects; real files have five.
const DEEPEST: usize = 64;
/// Largest number of lists, tuples and dictionaries in a file; real files have fifty.
///
/// They may hold each other and are dropped recursively.
const MOST_CONTAINERS: usize = 2000;
/// Largest number of axes of an array.
const MOST_AXES: usize = 8;

/// A value that a pickle holds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    None,
    Bool(bool),
    Integer(i64),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
    /// Lists and tuples.
    List(Vec<Self>),
    /// Key-value pairs in order; a later pair replaces an earlier one with the same key.
    Dictionary(Vec<(Self, Self)>),
    Array(Array),
    /// An object that this reader does not know, by the name of its function or class.
    Unknown(String),
}

/// A NumPy array of numbers.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Array {
    pub(crate) shape: Vec<usize>,
    /// In C order.
    pub(crate) values: Vec<f64>,
}

/// An entry of the stack. Lists and dictionaries are filled after they are memoised, hence shared.
#[derive(Clone)]
enum Item {
    Plain(Value),
    Bytes(Rc<[u8]>),
    Tuple(Rc<[Self]>),
    List(Rc<RefCell<Vec<Self>>>),
    Dictionary(Rc<RefCell<Vec<(Self, Self)>>>),
    Function(Function),
    Type(Number),
    Array(Rc<RefCell<Unfinished>>),
    /// What an unknown function or class makes, and that function itself.
    Unknown(Rc<str>),
}

/// The functions and types that NumPy's pickles name.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Function {
    /// An empty array, filled by BUILD.
    Reconstruct,
    /// An array from a buffer, protocol 5.
    FromBuffer,
    /// A number of a NumPy type.
    Scalar,
    Type,
    NdArray,
    /// Bytes as text, protocol 2.
    Encode,
    Bytes,
    ByteArray,
    OrderedDict,
}

#[derive(Default)]
struct Unfinished {
    shape: Vec<usize>,
    number: Option<Number>,
    fortran: bool,
    bytes: Option<Rc<[u8]>>,
    /// The type of its elements, if they are no numbers.
    unknown: Option<Rc<str>>,
}

type Parsed<T> = std::result::Result<T, String>;

/// Parses the pickle `content` of the file `path`.
///
/// # Errors
/// [`Error::Format`] for the first byte that is not data known to this reader.
pub(crate) fn parse(content: &[u8], path: &Path) -> Result<Value> {
    let mut machine = Machine {
        content,
        at: 0,
        stack: Vec::new(),
        marks: Vec::new(),
        memo: BTreeMap::new(),
        spent: 0,
        containers: 0,
    };
    let outcome = machine.run().and_then(|item| machine.finish(&item, 0)).and_then(|value| match value {
        Value::Unknown(name) => Err(format!("a call of {name}")),
        value => Ok(value),
    });
    outcome.map_err(|found| {
        let expected = "a pickle of numbers, texts, lists, dictionaries and NumPy arrays, protocol 2 to 5";
        let remedy = "save it again as plain NumPy arrays and numbers: this reader runs no code";
        Error::format(path, format!("byte {}", machine.at), found, expected, remedy)
    })
}

struct Machine<'a> {
    content: &'a [u8],
    at: usize,
    stack: Vec<Item>,
    marks: Vec<usize>,
    memo: BTreeMap<usize, Item>,
    /// Bytes of all values built so far: a memoised value that is used often must not grow without bound.
    spent: usize,
    containers: usize,
}

impl Machine<'_> {
    fn run(&mut self) -> Parsed<Item> {
        loop {
            match self.byte()? {
                // PROTO, FRAME: the protocol; the length of the frame.
                0x80 => {
                    let protocol = self.byte()?;
                    if !(2..=5).contains(&protocol) {
                        return Err(format!("protocol {protocol}"));
                    }
                }
                0x95 => {
                    self.take(8)?;
                }
                b'.' => return self.pop(),
                b'(' => self.marks.push(self.stack.len()),
                b'0' => {
                    self.pop()?;
                }
                b'N' => self.push(Value::None),
                0x88 => self.push(Value::Bool(true)),
                0x89 => self.push(Value::Bool(false)),
                code @ (b'K' | b'M') => {
                    let value = self.unsigned(if code == b'K' { 1 } else { 2 })?;
                    self.integer(value)?;
                }
                b'J' => {
                    let value = self.unsigned(4)? as u32;
                    self.push(Value::Integer(i64::from(value.cast_signed())));
                }
                0x8a => self.long()?,
                b'G' => {
                    let bytes = self.take(8)?.try_into().expect("eight bytes");
                    self.push(Value::Float(f64::from_be_bytes(bytes)));
                }
                0x8c => self.text(1)?,
                b'X' => self.text(4)?,
                0x8d => self.text(8)?,
                b'U' | b'C' => self.bytes(1)?,
                b'T' | b'B' => self.bytes(4)?,
                0x8e | 0x96 => self.bytes(8)?,
                b']' => self.contain(Item::List(Rc::default()))?,
                b'}' => self.contain(Item::Dictionary(Rc::default()))?,
                b')' => self.stack.push(Item::Tuple(Rc::from([]))),
                count @ 0x85..=0x87 => self.tuple(self.stack.len().checked_sub(usize::from(count - 0x84)))?,
                b't' => {
                    let mark = self.mark()?;
                    self.tuple(Some(mark))?;
                }
                b'a' => {
                    let value = self.pop()?;
                    self.append(vec![value])?;
                }
                b'e' => {
                    let mark = self.mark()?;
                    let values = self.stack.split_off(mark);
                    self.append(values)?;
                }
                b's' => {
                    let (value, key) = (self.pop()?, self.pop()?);
                    self.set(vec![key, value])?;
                }
                b'u' => {
                    let mark = self.mark()?;
                    let pairs = self.stack.split_off(mark);
                    self.set(pairs)?;
                }
                code @ (b'q' | b'r') => {
                    let key = self.unsigned(if code == b'q' { 1 } else { 4 })?;
                    self.remember(key)?;
                }
                0x94 => self.remember(self.memo.len())?,
                code @ (b'h' | b'j') => {
                    let key = self.unsigned(if code == b'h' { 1 } else { 4 })?;
                    self.recall(key)?;
                }
                b'c' => {
                    let (module, name) = (self.line()?, self.line()?);
                    self.global(&module, &name)?;
                }
                0x93 => {
                    let (name, module) = (self.pop_text()?, self.pop_text()?);
                    self.global(&module, &name)?;
                }
                b'R' => self.reduce()?,
                // NEWOBJ and NEWOBJ_EX: a class, its arguments, and named ones.
                0x81 => self.reduce()?,
                0x92 => {
                    self.pop()?;
                    self.reduce()?;
                }
                b'b' => self.build()?,
                b'S' => {
                    let text = self.line()?;
                    self.push(Value::Text(text.trim_matches(['\'', '"']).to_owned()));
                }
                // Sets are unknown: EMPTY_SET, ADDITEMS, FROZENSET.
                0x8f => self.stack.push(Item::Unknown("a set".into())),
                0x90 => {
                    let mark = self.mark()?;
                    self.stack.truncate(mark);
                }
                0x91 => {
                    let mark = self.mark()?;
                    self.stack.truncate(mark);
                    self.stack.push(Item::Unknown("a set".into()));
                }
                other => return Err(format!("the operation {other:#04x}")),
            }
        }
    }

    fn byte(&mut self) -> Parsed<u8> {
        self.take(1).map(|bytes| bytes[0])
    }

    fn take(&mut self, count: usize) -> Parsed<&[u8]> {
        let end = self.at.checked_add(count).filter(|&end| end <= self.content.len()).ok_or("the end of the file")?;
        let bytes = &self.content[self.at..end];
        self.at = end;
        Ok(bytes)
    }

    /// A little-endian number of `size` bytes.
    fn unsigned(&mut self, size: usize) -> Parsed<usize> {
        let value = self.take(size)?.iter().rev().fold(0_u64, |value, &byte| value << 8 | u64::from(byte));
        usize::try_from(value).map_err(|_| format!("the length {value}"))
    }

    fn line(&mut self) -> Parsed<String> {
        let rest = &self.content[self.at..];
        let length = rest.iter().take(256).position(|&byte| byte == b'\n').ok_or("a name without an end")?;
        let text = String::from_utf8_lossy(&rest[..length]).into_owned();
        self.at += length + 1;
        Ok(text)
    }

    fn push(&mut self, value: Value) {
        self.stack.push(Item::Plain(value));
    }

    fn integer(&mut self, value: usize) -> Parsed<()> {
        let value = i64::try_from(value).map_err(|_| format!("the number {value}"))?;
        self.push(Value::Integer(value));
        Ok(())
    }

    /// A signed number of any length; only lengths of up to eight bytes are supported.
    fn long(&mut self) -> Parsed<()> {
        let size = usize::from(self.byte()?);
        let bytes = self.take(size)?;
        if size > 8 {
            self.stack.push(Item::Unknown(format!("a whole number of {size} bytes").into()));
            return Ok(());
        }
        let negative = bytes.last().is_some_and(|byte| byte & 0x80 != 0);
        let mut all = [if negative { 0xff } else { 0 }; 8];
        all[..size].copy_from_slice(bytes);
        self.push(Value::Integer(i64::from_le_bytes(all)));
        Ok(())
    }

    fn text(&mut self, size: usize) -> Parsed<()> {
        let length = self.unsigned(size)?;
        let text = std::str::from_utf8(self.take(length)?).map_err(|_| "a text that is not UTF-8")?.to_owned();
        self.push(Value::Text(text));
        Ok(())
    }

    fn bytes(&mut self, size: usize) -> Parsed<()> {
        let length = self.unsigned(size)?;
        let bytes = Rc::from(self.take(length)?);
        self.stack.push(Item::Bytes(bytes));
        Ok(())
    }

    fn pop(&mut self) -> Parsed<Item> {
        self.stack.pop().ok_or_else(|| "an empty stack".into())
    }

    fn pop_text(&mut self) -> Parsed<String> {
        match self.pop()? {
            Item::Plain(Value::Text(text)) => Ok(text),
            _ => Err("a name that is no text".into()),
        }
    }

    fn mark(&mut self) -> Parsed<usize> {
        self.marks.pop().filter(|&mark| mark <= self.stack.len()).ok_or_else(|| "a mark that is missing".into())
    }

    fn tuple(&mut self, from: Option<usize>) -> Parsed<()> {
        let items = self.stack.split_off(from.ok_or("an empty stack")?);
        self.contain(Item::Tuple(items.into()))
    }

    fn contain(&mut self, container: Item) -> Parsed<()> {
        self.containers += 1;
        if self.containers > MOST_CONTAINERS {
            return Err(format!("more than {MOST_CONTAINERS} lists, tuples and dictionaries"));
        }
        self.stack.push(container);
        Ok(())
    }

    fn append(&mut self, values: Vec<Item>) -> Parsed<()> {
        match self.stack.last() {
            Some(Item::List(list)) => list.borrow_mut().extend(values),
            Some(Item::Unknown(_)) => {}
            _ => return Err("an element without a list".into()),
        }
        Ok(())
    }

    fn set(&mut self, pairs: Vec<Item>) -> Parsed<()> {
        let dictionary = match self.stack.last() {
            Some(Item::Dictionary(dictionary)) => dictionary,
            Some(Item::Unknown(_)) => return Ok(()),
            _ => return Err("a key without a dictionary".into()),
        };
        if pairs.len() % 2 == 1 {
            return Err("a key without a value".into());
        }
        let mut pairs = pairs.into_iter();
        while let (Some(key), Some(value)) = (pairs.next(), pairs.next()) {
            dictionary.borrow_mut().push((key, value));
        }
        Ok(())
    }

    fn remember(&mut self, key: usize) -> Parsed<()> {
        let top = self.stack.last().ok_or("an empty stack")?.clone();
        self.memo.insert(key, top);
        Ok(())
    }

    fn recall(&mut self, key: usize) -> Parsed<()> {
        let item = self.memo.get(&key).ok_or("a memory that was not kept")?.clone();
        self.stack.push(item);
        Ok(())
    }

    fn global(&mut self, module: &str, name: &str) -> Parsed<()> {
        // NumPy 2 renamed its private modules.
        let function = match (module.replace("numpy._core", "numpy.core").as_str(), name) {
            ("numpy.core.multiarray", "_reconstruct") => Function::Reconstruct,
            ("numpy.core.multiarray", "scalar") => Function::Scalar,
            ("numpy.core.numeric", "_frombuffer") => Function::FromBuffer,
            ("numpy", "dtype") => Function::Type,
            ("numpy", "ndarray") => Function::NdArray,
            ("_codecs", "encode") => Function::Encode,
            ("builtins" | "__builtin__", "bytes") => Function::Bytes,
            ("builtins" | "__builtin__", "bytearray") => Function::ByteArray,
            ("collections", "OrderedDict") => Function::OrderedDict,
            _ => {
                self.stack.push(Item::Unknown(format!("{module}.{name}").into()));
                return Ok(());
            }
        };
        self.stack.push(Item::Function(function));
        Ok(())
    }

    /// Replaces a function and its arguments on the stack by the result.
    fn reduce(&mut self) -> Parsed<()> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let (arguments, function) = match (arguments, function) {
            (Item::Tuple(arguments), Item::Function(function)) => (arguments, function),
            (_, unknown @ Item::Unknown(_)) => {
                self.stack.push(unknown);
                return Ok(());
            }
            _ => return Err("a call of something unknown".into()),
        };
        let made = match (function, &*arguments) {
            (Function::Reconstruct, _) => Item::Array(Rc::default()),
            (Function::Type, [Item::Plain(Value::Text(name)), ..]) => {
                // Texts and objects, for instance.
                Number::parse(name).map_or_else(|other| Item::Unknown(other.into()), Item::Type)
            }
            (
                Function::FromBuffer,
                [Item::Bytes(bytes), Item::Type(number), shape, Item::Plain(Value::Text(order))],
            ) => {
                let (shape, bytes) = (self.shape(shape)?, Some(bytes.clone()));
                let array = Unfinished { shape, number: Some(*number), fortran: order == "F", bytes, unknown: None };
                Item::Array(Rc::new(RefCell::new(array)))
            }
            (Function::Scalar, [Item::Type(number), Item::Bytes(bytes)]) if bytes.len() == number.size => {
                Item::Plain(Value::Float(number.read(bytes)))
            }
            (Function::Encode, [Item::Plain(Value::Text(text)), ..]) => {
                let bytes: Option<Vec<u8>> = text.chars().map(|c| u8::try_from(u32::from(c)).ok()).collect();
                Item::Bytes(bytes.ok_or("bytes that are no Latin-1")?.into())
            }
            (Function::Bytes | Function::ByteArray, []) => Item::Bytes(Rc::from([])),
            (Function::Bytes | Function::ByteArray, [Item::Bytes(bytes)]) => Item::Bytes(bytes.clone()),
            (_, arguments) if arguments.iter().any(|item| matches!(item, Item::Unknown(_))) => {
                arguments.iter().find(|item| matches!(item, Item::Unknown(_))).cloned().expect("there is one")
            }
            (Function::OrderedDict, []) => return self.contain(Item::Dictionary(Rc::default())),
            _ => return Err("a call with other arguments than NumPy's".into()),
        };
        self.stack.push(made);
        Ok(())
    }

    /// Completes the object below the top of the stack with the state on top.
    fn build(&mut self) -> Parsed<()> {
        let state = self.pop()?;
        if let Some(Item::Unknown(_)) = self.stack.last() {
            return Ok(());
        }
        let (Some(object), Item::Tuple(state)) = (self.stack.last_mut(), &state) else {
            return Err("a state without an object".into());
        };
        match (object, &**state) {
            // (version, byte order, …)
            (Item::Type(number), [_, Item::Plain(Value::Text(order)), ..]) => number.big_endian = order == ">",
            // (version, shape, type, Fortran order, bytes)
            (
                Item::Array(array),
                [_, shape, Item::Type(number), Item::Plain(Value::Bool(fortran)), Item::Bytes(bytes)],
            ) => {
                let (array, number, fortran, bytes) = (array.clone(), *number, *fortran, bytes.clone());
                let shape = self.shape(shape)?;
                *array.borrow_mut() =
                    Unfinished { shape, number: Some(number), fortran, bytes: Some(bytes), unknown: None };
            }
            // An array whose elements are no numbers.
            (Item::Array(array), [_, _, Item::Unknown(name), ..]) => array.borrow_mut().unknown = Some(name.clone()),
            _ => return Err("a state that is not NumPy's".into()),
        }
        Ok(())
    }

    fn shape(&self, item: &Item) -> Parsed<Vec<usize>> {
        let Item::Tuple(sides) = item else { return Err("a shape that is no tuple".into()) };
        let side = |item: &Item| match item {
            Item::Plain(Value::Integer(n)) => usize::try_from(*n).ok(),
            _ => None,
        };
        let shape: Option<Vec<usize>> = sides.iter().map(side).collect();
        shape.filter(|shape| shape.len() <= MOST_AXES).ok_or_else(|| "a shape that is none".into())
    }

    /// The value of an item and of everything in it.
    fn finish(&mut self, item: &Item, depth: usize) -> Parsed<Value> {
        if depth > DEEPEST {
            return Err(format!("objects within objects, more than {DEEPEST} deep"));
        }
        self.spend(1)?;
        Ok(match item {
            Item::Plain(value) => {
                if let Value::Text(text) = value {
                    self.spend(text.len())?;
                }
                value.clone()
            }
            Item::Bytes(bytes) => {
                self.spend(bytes.len())?;
                Value::Bytes(bytes.to_vec())
            }
            Item::Tuple(items) => Value::List(items.iter().map(|i| self.finish(i, depth + 1)).collect::<Parsed<_>>()?),
            Item::List(items) => {
                let items = items.borrow().clone();
                Value::List(items.iter().map(|i| self.finish(i, depth + 1)).collect::<Parsed<_>>()?)
            }
            Item::Dictionary(pairs) => {
                let pairs = pairs.borrow().clone();
                let finish =
                    |(key, value): &(Item, Item)| Ok((self.finish(key, depth + 1)?, self.finish(value, depth + 1)?));
                Value::Dictionary(pairs.iter().map(finish).collect::<Parsed<_>>()?)
            }
            Item::Array(array) => match &array.borrow().unknown {
                Some(name) => self.unknown(name)?,
                None => Value::Array(self.array(&array.borrow())?),
            },
            Item::Unknown(name) => self.unknown(name)?,
            Item::Function(_) | Item::Type(_) => Value::None,
        })
    }

    fn unknown(&mut self, name: &str) -> Parsed<Value> {
        self.spend(name.len())?;
        Ok(Value::Unknown(name.into()))
    }

    fn array(&mut self, array: &Unfinished) -> Parsed<Array> {
        let (Some(number), Some(bytes)) = (array.number, &array.bytes) else {
            return Err("an array without content".into());
        };
        self.spend(bytes.len())?;
        let count = array.shape.iter().try_fold(1_usize, |count, &side| count.checked_mul(side));
        if count.and_then(|count| count.checked_mul(number.size)) != Some(bytes.len()) {
            return Err(format!("{} bytes for an array of shape {:?}", bytes.len(), array.shape));
        }
        let values: Vec<f64> = bytes.chunks_exact(number.size).map(|bytes| number.read(bytes)).collect();
        let shape = array.shape.clone();
        if !array.fortran || shape.len() < 2 {
            return Ok(Array { shape, values });
        }
        let reversed: Vec<usize> = shape.iter().rev().copied().collect();
        let transposed = ndarray::ArrayD::from_shape_vec(reversed, values).expect("the count was checked");
        let values = transposed.reversed_axes().iter().copied().collect();
        Ok(Array { shape, values })
    }

    /// Rejects a file whose values would take many times its own size.
    fn spend(&mut self, size: usize) -> Parsed<()> {
        self.spent = self.spent.saturating_add(size);
        if self.spent > 4 * self.content.len() + 4096 {
            return Err("a small file that expands to a large object".into());
        }
        Ok(())
    }
}

impl Value {
    /// The value of a key of a dictionary.
    pub(crate) fn get(&self, key: &str) -> Option<&Self> {
        let Self::Dictionary(pairs) = self else { return None };
        pairs.iter().rev().find(|(name, _)| matches!(name, Self::Text(name) if name == key)).map(|(_, value)| value)
    }

    /// The texts among the keys of a dictionary, with their values.
    pub(crate) fn fields(&self) -> impl Iterator<Item = (&str, &Self)> {
        let pairs: &[(Self, Self)] = if let Self::Dictionary(pairs) = self { pairs } else { &[] };
        pairs.iter().filter_map(|(key, value)| match key {
            Self::Text(name) => Some((name.as_str(), value)),
            _ => None,
        })
    }

    /// A number of any kind.
    pub(crate) fn number(&self) -> Option<f64> {
        match self {
            Self::Integer(value) => Some(*value as f64),
            Self::Float(value) => Some(*value),
            Self::Array(array) if array.values.len() == 1 => Some(array.values[0]),
            _ => None,
        }
    }

    /// Numbers of a list, a tuple or an array of one axis.
    pub(crate) fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::List(values) => values.iter().map(Self::number).collect(),
            Self::Array(array) if array.shape.len() == 1 => Some(array.values.clone()),
            _ => None,
        }
    }
}
