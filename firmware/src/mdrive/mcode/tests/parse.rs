//! Lines and their meaning, typed from MC and FB.

use std::vec::Vec;

use proptest::prelude::*;

use super::super::super::error::Error;
use super::super::super::registers::{HYBRID, PLUS, Reg};
use super::super::mnemonic::{Mnemonic, SERIAL, find};
use super::super::names::{Meaning, Names};
use super::super::operand::{List, Operand, Operator, Parameter, Place, Relation, Step, Trip};
use super::super::parse::{self, Expression, without_comment};
use super::super::statement::Statement;

fn parsed(line: &str) -> Result<Statement<'_>, Error> {
    parse::parse(line.as_bytes(), PLUS, &Names::new())
}

fn on_hybrid(line: &str) -> Result<Statement<'_>, Error> {
    parse::parse(line.as_bytes(), HYBRID, &Names::new())
}

/// Parsed value of a typed text.
fn typed(text: &str) -> Expression<'static> {
    let line: &'static str = std::format!("R1={text}").leak();
    match parsed(line) {
        Ok(Statement::Set(Reg::R1, value)) => value,
        other => panic!("{text}: {other:?}"),
    }
}

fn number(number: i32) -> Expression<'static> {
    typed(&std::format!("{number}"))
}

/// Steps of the value or the condition in a line.
fn steps(line: &str) -> Vec<Step> {
    match parsed(line) {
        Ok(
            Statement::Set(_, value)
            | Statement::SetUser(_, value)
            | Statement::Number(value)
            | Statement::Move { way: value, .. }
            | Statement::Branch(_, Some(value))
            | Statement::Call(_, Some(value)),
        ) => value.steps().collect(),
        other => panic!("{line}: {other:?}"),
    }
}

fn step(operator: Operator, operand: Operand) -> Step {
    Step::Calculate { operator, not: false, operand }
}

/// First operand of an expression.
fn first(operand: Operand) -> Step {
    step(Operator::Plus, operand)
}

fn values(values: &[i32]) -> heapless::Vec<Parameter, 3> {
    values.iter().map(|value| Parameter::Value(Operand::Number(*value))).collect()
}

#[test]
fn equals_a_blank_or_nothing_separates_a_name_from_its_value() {
    let set = Ok(Statement::Set(Reg::VM, number(5_000)));
    for line in ["VM=5000", "VM 5000", "VM5000", "vm = 5000", "  Vm   =5000  ", "\tVM\t5000", "VM = +5000"] {
        assert_eq!(parsed(line), set, "{line}");
    }
    assert_eq!(parsed("P=-20"), Ok(Statement::Set(Reg::P, number(-20))));
    assert_eq!(parsed("P - 20"), Ok(Statement::Set(Reg::P, number(-20))));
    assert_eq!(parsed("A1000"), Ok(Statement::Set(Reg::A, number(1_000))));
    assert_eq!(parsed("D1 100"), Ok(Statement::Set(Reg::D1, number(100))));
    assert_eq!(parsed("ER 0"), Ok(Statement::Set(Reg::ER, number(0))));
    assert_eq!(parsed("R1=-2147483648"), Ok(Statement::Set(Reg::R1, number(i32::MIN))));
    assert_eq!(parsed("R1=2147483648"), Err(Error::IllegalValue));
    assert_eq!(parsed("R1=99999999999999999999999999"), Err(Error::IllegalValue));
}

#[test]
fn a_comment_or_nothing_is_no_statement() {
    for line in ["", "   ", "'nothing", "  ' PR \"x\""] {
        assert_eq!(parsed(line), Ok(Statement::Empty), "{line}");
    }
    assert_eq!(parsed("H 2000 'two seconds"), Ok(Statement::Hold(Some(number(2_000)))));
    assert_eq!(without_comment(b" PR \"it's\" 'so"), b"PR \"it's\"");
}

#[test]
fn expressions_are_carried_out_from_left_to_right() {
    use Operand::{Number, User, Variable};
    let (r1, r2) = (Variable(Reg::R1), Variable(Reg::R2));
    for (text, operator) in [
        ("R1+R2", Operator::Plus),
        ("R1 - R2", Operator::Minus),
        ("r1*r2", Operator::Times),
        ("R1 /R2", Operator::Over),
        ("R1& R2", Operator::And),
        ("R1|R2", Operator::Or),
        ("R1^R2", Operator::Xor),
    ] {
        let line = std::format!("R3={text}");
        assert_eq!(steps(&line), [first(r1), step(operator, r2)], "{line}");
    }
    assert_eq!(steps("VM 5000"), [first(Number(5_000))]);
    assert_eq!(steps("MR 0*51200"), [first(Number(0)), step(Operator::Times, Number(51_200))], "(MC 8.3)");
    assert_eq!(steps("R1=R1--5"), [first(r1), step(Operator::Minus, Number(-5))]);
    let turned = |operator, operand| Step::Calculate { operator, not: true, operand };
    assert_eq!(steps("R1=!Q1"), [turned(Operator::Plus, User(*b"Q1"))]);
    assert_eq!(steps("R1=R2 & !Q1"), [first(r2), turned(Operator::And, User(*b"Q1"))]);
    assert_eq!(steps("Q1=P"), [first(Variable(Reg::P))]);
    assert_eq!(steps("-5000"), [first(Number(-5_000))]);
    assert_eq!(steps("100*2"), [first(Number(100)), step(Operator::Times, Number(2))]);
    assert_eq!(steps("R1=-R2"), [step(Operator::Minus, r2)]);
    assert_eq!(steps("- R2"), [step(Operator::Minus, r2)]);

    // An expression is as long as a line allows.
    let p = Variable(Reg::P);
    assert_eq!(
        steps("R2 = P - R1 / 2"),
        [first(p), step(Operator::Minus, r1), step(Operator::Over, Number(2))]
    );
    assert_eq!(steps("R1=-R2+R1"), [step(Operator::Minus, r2), step(Operator::Plus, r1)]);
    let longest = std::format!("R1=1{}", "+1".repeat(30));
    assert_eq!((longest.len(), steps(&longest).len()), (64, 31));

    for line in
        ["R1=", "R1=R2+", "R1=*2", "R1==2", "R1=1.5", "R1=2A", "R1>5", "5x", "5,", "R1=$", "R1=R2+R3 *"]
    {
        assert_eq!(parsed(line), Err(Error::IllegalData), "{line}");
    }
    assert_eq!(parsed("R1=R2+5 R3"), Err(Error::MissingSeparator));
}

#[test]
fn a_ratio_is_in_thousandths() {
    for (line, value) in [
        ("CR=1.500", 1_500),
        ("CR 1", 1_000),
        ("CR=.5", 500),
        ("CR=2.", 2_000),
        ("CR=0.05", 50),
        ("CR=2.000", 2_000),
        ("CR=1.5000", 1_500),
        ("CR=0.001", 1),
        ("CR=-.25", -250),
    ] {
        assert!(matches!(parsed(line), Ok(Statement::Set(Reg::CR, _))), "{line}");
        assert_eq!(steps(line), [first(Operand::Ratio(value))], "{line}");
    }
    // The value is finer than the thousandths in which CR is stored.
    assert_eq!(parsed("CR=1.0005"), Err(Error::IllegalValue));
    for line in ["CR=.", "CR=", "CR=1.5.0", "CR=1.5X", "CR=X.5", "CR=1X.5", "R1=.5", "MR 1.5"] {
        assert!(matches!(parsed(line), Err(Error::IllegalData | Error::UnknownLabel)), "{line}");
    }
    assert_eq!(steps("1.5"), [first(Operand::Ratio(1_500))], "for IV");
    let equal = Step::Compare(Relation::Equal, Operand::Ratio(1_000));
    assert_eq!(steps("BR K1,CR=1.0"), [first(Operand::Variable(Reg::CR)), equal]);
}

#[test]
fn branches_and_calls_have_a_place_and_a_condition() {
    use Operand::{Number, User, Variable};
    assert_eq!(parsed("BR G1"), Ok(Statement::Branch(Place::Label(*b"G1"), None)));
    assert!(matches!(parsed("BR 256, I2=1"), Ok(Statement::Branch(Place::Address(256), Some(_)))));
    assert_eq!(steps("BR 256, I2=1"), [first(Variable(Reg::I2)), Step::Compare(Relation::Equal, Number(1))]);
    for (text, relation) in [
        ("=", Relation::Equal),
        ("<>", Relation::Unequal),
        ("<", Relation::Less),
        ("<=", Relation::AtMost),
        (">", Relation::Greater),
        (">=", Relation::AtLeast),
    ] {
        let line = std::format!("CL k5,Q4{text}-10");
        assert!(matches!(parsed(&line), Ok(Statement::Call(Place::Label([b'K', b'5']), Some(_)))), "{line}");
        assert_eq!(steps(&line), [first(User(*b"Q4")), Step::Compare(relation, Number(-10))], "{line}");
    }
    assert_eq!(steps("BR K1,VC"), [first(Variable(Reg::VC))]);
    // "Flags as well as logical functions" (MC 5-6).
    assert_eq!(steps("BR K1,R1 & 4"), [first(Variable(Reg::R1)), step(Operator::And, Number(4))]);
    assert_eq!(
        steps("CL Ya, R1<>1&Mv"),
        [
            first(Variable(Reg::R1)),
            Step::Compare(Relation::Unequal, Number(1)),
            step(Operator::And, Variable(Reg::MV))
        ]
    );
    assert_eq!(steps("BR K1,P-R1>5").len(), 3);
    // "Only one condition may exist" (MC 5-6).
    assert_eq!(parsed("BR K1,R1=1=R2"), Err(Error::IllegalData));
    assert_eq!(parsed("BR K1,R1=1&R2=2"), Err(Error::IllegalData));
    assert_eq!(parsed("BR K1,P>R1+5"), Err(Error::IllegalData), "1 + 5 is no condition");
    assert_eq!(parsed("BR K1 VC=1"), Err(Error::MissingSeparator));
    assert_eq!(parsed("BR K1,"), Err(Error::IllegalData));
    assert_eq!(parsed("BR"), Err(Error::IllegalData));
    assert_eq!(parsed("BR VM"), Err(Error::UnknownLabel));
    assert_eq!(parsed("BR ABC"), Err(Error::UnknownLabel));
    assert_eq!(parsed("BR K1,MR=1"), Err(Error::UnknownLabel), "an instruction is no operand");
}

#[test]
fn moves_may_announce_their_end_and_go_on() {
    let way = |relative, way, notify_on_end, continuous| {
        Ok(Statement::Move { relative, way: number(way), notify_on_end, continuous })
    };
    assert_eq!(parsed("MA 200000"), way(false, 200_000, false, false));
    assert_eq!(parsed("ma100000,1"), way(false, 100_000, true, false));
    assert_eq!(parsed("MA 512000,0,1"), way(false, 512_000, false, true));
    assert_eq!(parsed("MR=-5 , , 1"), way(true, -5, false, true));
    assert_eq!(parsed("MR 1,2"), Err(Error::IllegalValue));
    assert_eq!(parsed("MR 1,1,1,1"), Err(Error::IllegalData));
    assert_eq!(parsed("MR 1 1"), Err(Error::MissingSeparator));
    assert_eq!(parsed("MR"), Err(Error::IllegalData));
    assert_eq!(parsed("SL=0"), Ok(Statement::Slew(number(0))));
    assert_eq!(parsed("HM 2"), Ok(Statement::Set(Reg::HM, number(2))));
    assert_eq!(parsed("HI=3"), Ok(Statement::HomeToIndex(number(3))));
    assert_eq!((parsed("HM"), parsed("HI")), (Err(Error::HomeType), Err(Error::HomeType)));
}

#[test]
fn instructions_of_programs() {
    let label = Place::Label(*b"G1");
    for (line, statement) in [
        ("E", Statement::End),
        ("rt", Statement::Return),
        ("PS", Statement::Pause),
        ("RS", Statement::Resume),
        ("S", Statement::Save),
        ("FD", Statement::Defaults),
        ("IP", Statement::Initialize),
        ("H", Statement::Hold(None)),
        ("H250", Statement::Hold(Some(number(250)))),
        ("H=R1", Statement::Hold(Some(typed("R1")))),
        ("H 5", Statement::Hold(Some(number(5)))),
        ("H5", Statement::Hold(Some(number(5)))),
        ("EX 1", Statement::Execute(Place::Address(1), None)),
        ("EXG1", Statement::Execute(label, None)),
        ("EX G1,2", Statement::Execute(label, Some(number(2)))),
        ("EX SU", Statement::Execute(Place::Label(*b"SU"), None)),
        ("PG", Statement::Program(None)),
        ("PG1", Statement::Program(Some(Place::Address(1)))),
        ("PG G1", Statement::Program(Some(label))),
        ("L", Statement::ListProgram(None)),
        ("L 100", Statement::ListProgram(Some(Place::Address(100)))),
        ("CP", Statement::Clear(None)),
        ("CP G1", Statement::Clear(Some(label))),
        ("OE G1", Statement::OnError(label)),
        ("OE 0", Statement::OnError(Place::Address(0))),
        ("BP G1, 3", Statement::BreakPoint(label, Some(number(3)))),
        ("BP=0", Statement::BreakPoint(Place::Address(0), None)),
        ("LB g1", Statement::Label(*b"G1")),
        ("LB SU", Statement::Label(*b"SU")),
        ("LB a", Statement::Label(*b"A ")),
        ("VA Q3", Statement::Declare(*b"Q3", None)),
        ("VA Q3=20000", Statement::Declare(*b"Q3", Some(number(20_000)))),
        ("VA Q3 5", Statement::Declare(*b"Q3", Some(number(5)))),
        ("VA x=P", Statement::Declare(*b"X ", Some(typed("P")))),
        ("IV R1", Statement::Input(Operand::Variable(Reg::R1))),
        ("IC Q1", Statement::Increment(Operand::User(*b"Q1"))),
        ("DC r2", Statement::Decrement(Operand::Variable(Reg::R2))),
        ("PR \"P=\",P;", Statement::Print(b"\"P=\",P;")),
    ] {
        // A label of one character may have the name of a variable.
        let expected = if line == "LB a" { Err(Error::BuiltIn) } else { Ok(statement) };
        let read = parsed(line);
        match (read, expected) {
            (Ok(Statement::Print(read)), Ok(Statement::Print(expected))) => {
                assert_eq!(read.trim_ascii(), expected, "{line}");
            }
            (read, expected) => assert_eq!(read, expected, "{line}"),
        }
    }
}

#[test]
fn lists_have_as_many_values_as_they_have() {
    use List::{Io, Trip as Tr};
    for (line, list, expected) in [
        ("S1=16,0,1", Io(Reg::S1), values(&[16, 0, 1])),
        ("S4 =7,0,0", Io(Reg::S4), values(&[7, 0, 0])),
        ("s2 0,1", Io(Reg::S2), values(&[0, 1])),
        ("S1=5", Io(Reg::S1), values(&[5])),
        ("S13=61,1", Io(Reg::S13), values(&[61, 1])),
        ("S5=9,0", Io(Reg::S5), values(&[9, 0])),
        ("TT=2000,300", Tr(Trip::Time), values(&[2_000, 300])),
        ("TR=650000,0,0", Tr(Trip::Relative), values(&[650_000, 0, 0])),
        ("TC=7", Tr(Trip::Capture), values(&[7])),
    ] {
        assert_eq!(parsed(line), Ok(Statement::SetList(list, expected)), "{line}");
    }
    let with_label =
        |value, name| heapless::Vec::from_slice(&[Parameter::Value(value), Parameter::Label(name)]).unwrap();
    assert_eq!(
        parsed("TP=650000,K9"),
        Ok(Statement::SetList(Tr(Trip::Position), with_label(Operand::Number(650_000), *b"K9")))
    );
    assert_eq!(
        parsed("TI R1,k3"),
        Ok(Statement::SetList(Tr(Trip::Input), with_label(Operand::Variable(Reg::R1), *b"K3")))
    );
    let variables: heapless::Vec<_, 3> = heapless::Vec::from_slice(&[
        Parameter::Value(Operand::User(*b"L1")),
        Parameter::Absent,
        Parameter::Value(Operand::Number(0)),
    ])
    .unwrap();
    assert_eq!(parsed("S1 = L1, , 0"), Ok(Statement::SetList(Io(Reg::S1), variables)));

    assert_eq!(parsed("S1=16 0"), Err(Error::MissingSeparator));
    for line in ["S1=", "S1=,", "S1 , ,", "TC="] {
        assert_eq!(parsed(line), Err(Error::IllegalData), "{line}");
    }
    assert_eq!(parsed("S1=16,0,1,1"), Err(Error::IllegalData));
    assert_eq!(parsed("S5=9,0,1"), Err(Error::IllegalData));
    assert_eq!(parsed("S1"), Err(Error::IsVariable));
    assert_eq!(parsed("TI=1,VM"), Err(Error::UnknownLabel));
}

#[test]
fn what_a_line_is_refused_for() {
    for (line, error) in [
        ("HELLO", 20),
        ("$", 20),
        ("QQ", 20),
        ("FOO 5", 20),
        ("\u{201C}x", 20),
        ("R1", 34),
        ("MV", 34),
        ("AL", 34),
        ("PN=5", 25),
        ("MD=1", 25),
        ("S=1", 33),
        ("RT=1", 33),
        ("E 5", 24),
        ("FD now", 24),
        ("LB", 24),
        ("LB K", 0),
        ("LB K12", 24),
        ("LB 1K", 24),
        ("LB P", 29),
        ("LB MR", 29),
        ("LB AT", 29),
        ("VA FT", 29),
        ("VA I7", 29),
        ("VA SU", 29),
        ("VA P", 29),
        ("VA VM=5", 29),
        ("VA Q12", 24),
        ("AT=1", 37),
        ("FT", 37),
        ("I10=1", 37),
        ("O12=1", 37),
        ("S9=0", 37),
        ("R1=IH", 37),
        ("UG 2956102", 37),
        ("BD=19", 37),
        ("CK=1", 37),
        ("DG=0", 37),
        ("DN=\"A\"", 37),
        ("PY=1", 37),
        ("QD=1", 37),
        ("R1=DN", 37),
        ("IC S1", 26),
        ("IC VR", 26),
        ("DC MR", 26),
        ("IC 5", 24),
        ("IC", 24),
        ("IV", 24),
        ("R1=S1", 30),
        ("R1=HM", 30),
        ("R1=QQQ", 30),
    ] {
        let read = parsed(line).map_or_else(|error| error as u8, |_| 0);
        assert_eq!(read, error, "{line}");
    }
}

#[test]
fn names_of_the_user_stand_before_shorter_ones_of_the_language() {
    let mut names = Names::new();
    names.add(*b"H5", Meaning::Global(0)).unwrap();
    names.add(*b"K1", Meaning::Label(7)).unwrap();
    let parsed = |line: &'static str| parse::parse(line.as_bytes(), PLUS, &names);
    assert_eq!(parsed("H5 7"), Ok(Statement::SetUser(*b"H5", number(7))));
    assert_eq!(parsed("H57"), Ok(Statement::SetUser(*b"H5", number(7))));
    assert_eq!(parsed("H67"), Ok(Statement::Hold(Some(number(67)))));
    assert_eq!(parsed("h6=7"), Ok(Statement::SetUser(*b"H6", number(7))), "it may be a local one");
    assert_eq!(parsed("H5"), Err(Error::IsVariable));
    assert_eq!(parsed("K1"), Err(Error::IsVariable));
    assert_eq!(
        parsed("K1=5"),
        Ok(Statement::SetUser(*b"K1", number(5))),
        "whoever sets it knows that it is one"
    );
}

#[test]
fn the_names_of_a_hybrid_are_free_on_an_mdriveplus() {
    for name in [
        "AF", "AS", "CA", "CB", "CC", "CF", "CT", "IT", "LD", "LG", "LL", "LR", "LT", "MF", "MU", "SC", "SS",
        "TA", "TD", "TQ", "TS", "VF", "WT",
    ] {
        let line = std::format!("VA {name}");
        assert!(matches!(parsed(&line), Ok(Statement::Declare(..))), "{name}");
        assert_eq!(on_hybrid(&line), Err(Error::BuiltIn), "{name}");
    }
    assert_eq!(on_hybrid("SC"), Ok(Statement::Calibrate(None)));
    for line in ["SC 0", "SC=0"] {
        assert_eq!(on_hybrid(line), Ok(Statement::Calibrate(Some(number(0)))), "{line}");
    }
    assert_eq!(on_hybrid("CF"), Ok(Statement::ClearLocked));
    assert_eq!(on_hybrid("MU=2,1"), Ok(Statement::SetList(List::With(Reg::MU), values(&[2, 1]))));
    // On a Hybrid I6 is a variable of MCode (MC 5-34).
    assert_eq!(find(b"I6", HYBRID), Some(Mnemonic::Variable(Reg::I6)));
    for name in ["CM", "CR", "DB", "FM", "PM", "S7", "S8", "SF", "SM", "ST"] {
        assert!(find(name.as_bytes(), PLUS).is_some(), "{name}");
        assert_eq!(find(name.as_bytes(), HYBRID), Some(Mnemonic::NotAvailable), "{name}");
    }
    // MC 5-58: PW is not a reserved word of the MDrive.
    assert_eq!((find(b"PW", PLUS), find(b"PW", HYBRID)), (None, None));
}

/// "Illegal I/O number" (MC 9.1), and "unknown variable or flag" (MC 9.2), whatever the value is.
#[test]
fn what_is_no_name_is_unknown_whatever_comes_behind() {
    for line in ["S6=0,0", "S0=0,0", "s14=1", "S6 0,0", "O13=1", "O5=1,2", "D13=1", "I14=1"] {
        assert_eq!(parsed(line), Err(Error::IllegalIo), "{line}");
    }
    for line in ["XX=4,K1", "XX=1,2", "TA=4,K1", "XX 1 2", "XX", "XX=", "XYZZY=1"] {
        assert_eq!(parsed(line), Err(Error::Unknown), "{line}");
    }
    // O5 is a name that a program may declare (MC 5-78).
    assert_eq!(parsed("O5=1"), Ok(Statement::SetUser(*b"O5", number(1))));
    // D with a number directly after it.
    assert_eq!(parsed("D60000"), Ok(Statement::Set(Reg::D, number(60_000))));
}

/// Names that IV cannot wait for (MC 5-39): an instruction cannot be set, and a keyword is read only.
#[test]
fn input_is_for_what_a_number_is_all_of() {
    for (line, error) in [
        ("IV H", 33),
        ("IV PR", 33),
        ("IV AL", 25),
        ("IV S1", 24),
        ("IV TT", 24),
        ("IV 5", 24),
        ("IV I9", 37),
    ] {
        assert_eq!(parsed(line).map_err(|error| error as u8), Err(error), "{line}");
    }
    assert_eq!(parsed("IC S1"), Err(Error::NotCountable));
}

#[test]
fn the_serial_sister_has_six_commands_more() {
    let parsed = |line: &'static str| parse::parse(line.as_bytes(), PLUS | SERIAL, &Names::new());
    assert_eq!(parsed("BD=19"), Ok(Statement::Set(Reg::BD, number(19))));
    assert_eq!(parsed("PY 1"), Ok(Statement::Set(Reg::PY, number(1))));
    for line in ["DN=\"A\"", "DN \"65\"", "dn = \"A\" "] {
        assert_eq!(parsed(line), Ok(Statement::Name(65)), "{line}");
    }
    assert_eq!(parsed("DN=\"a\""), Ok(Statement::Name(97)));
    assert_eq!(parsed("DN=A"), Err(Error::IllegalData));
    assert_eq!(parsed("DN=\"\""), Err(Error::IllegalData));
}

/// Every name of MC chapter 5 and of the tables of chapter 4, except those of the MForce and V1 to V8.
const NAMES: &str = "A AL AS AF AT BD BP BR BY C1 C2 CA CB CC CE CF CK CL CM CP CR CT CW D D1 D2 D3 D4 D5 D9 D10 D11 D12 DB DC \
    DE DG DN E EE EF EL EM ER ES EX FC FD FM FT H HC HI HM HT I1 I2 I3 I4 I5 I6 I7 I8 I9 I10 I11 I12 I13 IC IF IH IL IN IP \
    IT IV JE L LB LD LG LK LL LM LR LT MA MD MF MP MR MS MT MU MV NE O1 O2 O3 O4 O9 O10 O11 O12 OE OH OL OT P PC PG PM PN PR \
    PS PY QD R1 R2 R3 R4 RC RS RT S S1 S2 S3 S4 S5 S7 S8 S9 S10 S11 S12 S13 SC SF SL SM SN SS ST TA TC TD TE TI TP TQ TR TS \
    TT UG UV V VA VC VF VI VM VR WT";

#[test]
fn no_name_of_the_manual_is_free_and_no_other_is_taken() {
    let taken: Vec<&str> = NAMES.split_whitespace().collect();
    for first in b'A'..=b'Z' {
        for second in (b'0'..=b'9').chain(b'A'..=b'Z').chain([b' ']) {
            let name = [first, second];
            let text = core::str::from_utf8(&name).unwrap().trim_end();
            let known = find(text.as_bytes(), PLUS | HYBRID).is_some();
            assert_eq!(known, taken.contains(&text), "{text}");
        }
    }
    for name in taken {
        assert!(find(name.as_bytes(), PLUS | HYBRID).is_some(), "{name}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_a_statement_or_an_error(line in prop::collection::vec(any::<u8>(), 0..70), variants: u8) {
        let _ = parse::parse(&line, variants, &Names::new());
    }

    #[test]
    fn blanks_and_case_change_nothing(
        line in "(VM|C1|R1|MA|S1|BR|VA|TP|H|EX)[ =]?[A-Z0-9,+*=<>! -]{0,12}",
        blanks in 0_usize..3,
    ) {
        let pad = &"   "[..blanks];
        let other = std::format!("{pad}{}{pad} 'X", line.to_lowercase());
        prop_assert_eq!(parsed(&other), parsed(&line));
    }
}
