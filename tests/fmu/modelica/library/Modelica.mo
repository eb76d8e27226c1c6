within ;
package Modelica
  "Stands in for the Modelica Standard Library, which no registry has: the few classes that an
  exported package uses, with the connectors, parameters and equations that they have in 4.0.0"

  package Units
    package SI
      type Angle = Real(final quantity="Angle", final unit="rad");
      type AngularVelocity = Real(final quantity="AngularVelocity", final unit="rad/s");
      type AngularAcceleration = Real(final quantity="AngularAcceleration", final unit="rad/s2");
      type Torque = Real(final quantity="Torque", final unit="N.m");
      type Inertia = Real(final quantity="MomentOfInertia", final unit="kg.m2");
      type Power = Real(final quantity="Power", final unit="W");
    end SI;
  end Units;

  package Blocks
    package Interfaces
      connector RealInput = input Real;
      connector RealOutput = output Real;
    end Interfaces;

    package Sources
      block Constant
        parameter Real k;
        Interfaces.RealOutput y;
      equation
        y = k;
      end Constant;
    end Sources;
  end Blocks;

  package Mechanics
    package Rotational
      package Interfaces
        connector Flange_a
          Units.SI.Angle phi;
          flow Units.SI.Torque tau;
        end Flange_a;

        connector Flange_b
          Units.SI.Angle phi;
          flow Units.SI.Torque tau;
        end Flange_b;

        connector Support
          Units.SI.Angle phi;
          flow Units.SI.Torque tau;
        end Support;

        partial model PartialElementaryTwoFlangesAndSupport2
          parameter Boolean useSupport = false annotation (Evaluate=true);
          Flange_a flange_a;
          Flange_b flange_b;
          Support support(phi=phi_support, tau=-flange_a.tau - flange_b.tau) if useSupport;
        protected
          Units.SI.Angle phi_support;
        equation
          if not useSupport then
            phi_support = 0;
          end if;
        end PartialElementaryTwoFlangesAndSupport2;
      end Interfaces;

      package Components
        model Inertia
          parameter Units.SI.Inertia J;
          Interfaces.Flange_a flange_a;
          Interfaces.Flange_b flange_b;
          Units.SI.Angle phi;
          Units.SI.AngularVelocity w;
          Units.SI.AngularAcceleration a;
        equation
          phi = flange_a.phi;
          phi = flange_b.phi;
          w = der(phi);
          a = der(w);
          J*a = flange_a.tau + flange_b.tau;
        end Inertia;
      end Components;

      package Sources
        model Speed
          parameter Boolean exact = false;
          Interfaces.Flange_b flange;
          Blocks.Interfaces.RealInput w_ref;
          Units.SI.Angle phi(start=0, fixed=true);
          Units.SI.AngularVelocity w;
        equation
          assert(exact, "only the exact speed stands here");
          phi = flange.phi;
          w = der(phi);
          w = w_ref;
        end Speed;

        model Torque
          Interfaces.Flange_b flange;
          Blocks.Interfaces.RealInput tau;
        equation
          flange.tau = -tau;
        end Torque;
      end Sources;
    end Rotational;
  end Mechanics;
end Modelica;
